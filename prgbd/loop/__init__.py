"""The self-improving loop, and what it stands on: the sensor made of a network, and the memory of a run."""
