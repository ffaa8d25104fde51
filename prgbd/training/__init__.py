"""Losses, refinement on SLAM's output, and self-supervised pre-training of depth networks."""
