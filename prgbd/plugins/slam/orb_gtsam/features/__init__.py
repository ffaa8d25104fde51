"""ORB keypoints of images, and their matching: in windows, along epipolar lines, along the rows of a stereo pair.

Turns a frame as it is given into keypoints as the system uses them.
"""
