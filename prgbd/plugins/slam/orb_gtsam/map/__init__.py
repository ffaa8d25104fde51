"""The map: keyframes, points, who sees what, covisibility, and every operation that changes them.

Owns the lock that tracker and mapper share, and the files that maps are kept in.
"""
