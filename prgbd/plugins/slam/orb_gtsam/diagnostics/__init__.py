"""What the system says of itself: how wrong depth is, whether a map holds together, how long its stages take.

Reads maps and frames, changes neither.
"""
