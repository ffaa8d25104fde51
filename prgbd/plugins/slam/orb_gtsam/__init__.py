"""ORB-SLAM2's ideas in Python: features, tracking and mapping in numba, whole-map optimisation in GTSAM."""

from prgbd.plugins.slam.orb_gtsam.system import OrbGtsamSLAM

__all__ = ["OrbGtsamSLAM"]
