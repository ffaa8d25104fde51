"""YAML of the example; its folders are Hydra groups."""
