"""The Hydra configuration that ships with prgbd; YAML alone."""
