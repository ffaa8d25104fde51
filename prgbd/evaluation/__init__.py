"""How good depth and trajectories are, by the published protocols."""
