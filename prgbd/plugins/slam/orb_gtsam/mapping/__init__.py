"""What happens to the map after each keyframe: culling, triangulation, merging, bundle adjustment.

In step with the tracker or in a thread beside it; self-calibration and the last adjustment at the end.
"""
