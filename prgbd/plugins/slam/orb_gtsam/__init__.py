"""ORB-SLAM2's ideas in Python: features, tracking and mapping in numba, whole-map optimisation in GTSAM."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prgbd.plugins.slam.orb_gtsam.system import OrbGtsamSLAM

__all__ = ["OrbGtsamSLAM"]


def __getattr__(name: str) -> Any:
    """Load the system when it is used: the command line reads ``settings`` without it."""
    if name in __all__:
        from prgbd.plugins.slam.orb_gtsam import system

        return getattr(system, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
