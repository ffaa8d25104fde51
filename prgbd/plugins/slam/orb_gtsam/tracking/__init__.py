"""From keypoints to poses: initialisation, motion model, local map, keyframe decision, relocalisation, history.

Runs under the map's lock and hands new keyframes over to mapping.
"""
