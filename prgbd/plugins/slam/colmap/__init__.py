"""``colmap``: offline structure from motion with COLMAP (Schoenberger and Frahm, CVPR 2016), by its extra."""

from prgbd.plugins.slam.colmap.system import ColmapSLAM

__all__ = ["ColmapSLAM"]
