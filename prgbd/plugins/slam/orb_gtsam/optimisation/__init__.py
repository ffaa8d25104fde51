"""Solvers on arrays: the pose of a frame, local and global bundle adjustment (numba or GTSAM), pose graphs.

Owns residuals, weights and robust kernels; knows no map.
"""
