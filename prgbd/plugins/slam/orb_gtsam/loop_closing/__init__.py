"""Places seen again: the keyframe database with its visual words, detection, verification and correction of loops.

Joins maps of one place.
"""
