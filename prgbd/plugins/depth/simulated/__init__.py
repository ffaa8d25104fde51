"""A simulated depth sensor: the true depth of a recording with errors whose size and correlation are known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prgbd.plugins.depth.simulated.estimator import SimulatedDepth

__all__ = ["SimulatedDepth"]


def __getattr__(name: str) -> Any:
    """Load the estimator when it is used: the command line reads ``options`` without it."""
    if name in __all__:
        from prgbd.plugins.depth.simulated import estimator

        return getattr(estimator, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
