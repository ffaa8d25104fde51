"""Files: trajectories, maps and clouds, COLMAP models, written whole or not at all."""
