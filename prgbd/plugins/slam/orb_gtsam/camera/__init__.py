"""The camera as SLAM uses it: intrinsics, (virtual) baseline and pyramid, keypoint undistortion, depth noise.

Knows nothing of frames or maps.
"""
