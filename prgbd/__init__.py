"""prgbd: a depth network and a geometric SLAM system that improve each other from unlabelled monocular video.

The public face. Names are imported when they are first used, so ``import prgbd`` stays light.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import prgbd.plugins  # registers the built-in ids; imports none of them  # noqa: F401
from prgbd.version import __version__

_HOMES = {
    "prgbd.core.types": (
        "DepthPrediction",
        "Frame",
        "Keyframes",
        "MapPoints",
        "Observations",
        "PinholeCamera",
        "SlamResult",
        "Trajectory",
    ),
    "prgbd.core.refinement_batch": ("RefinementBatch", "View"),
    "prgbd.core.augmentation": ("Augmentation",),
    "prgbd.core.criterion": ("Criterion", "Evidence", "Verdict"),
    "prgbd.core.depth": ("DepthEstimator",),
    "prgbd.core.loss": ("LossInputs", "LossTerm"),
    "prgbd.core.wrappers": ("DepthWrapper",),
    "prgbd.core.slam": ("GeometricSLAM", "TrackingResult", "TrackingState"),
    "prgbd.core.data": ("Sequence",),
    "prgbd.core.registry": (
        "PluginSpec",
        "make_augmentation",
        "make_criterion",
        "make_data",
        "make_depth",
        "make_loss",
        "make_sequences",
        "make_slam",
        "register_augmentation",
        "register_criterion",
        "register_data",
        "register_depth",
        "register_loss",
        "register_slam",
    ),
    "prgbd.core.testing.refinement_checks": ("check_augmentation", "check_criterion", "check_loss"),
    "prgbd.core.testing.conformance": ("check_depth_estimator", "check_sequence", "check_slam"),
    "prgbd.core.errors": ("PrgbdError",),
    "prgbd.io.export": ("load_result", "save_result"),
    "prgbd.io.trajectory_files": ("to_evo",),
    "prgbd.loop.improve": ("improve",),
    "prgbd.loop.improvement": ("Improvement",),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "Augmentation",
    "Criterion",
    "DepthEstimator",
    "DepthPrediction",
    "DepthWrapper",
    "Evidence",
    "Frame",
    "GeometricSLAM",
    "Improvement",
    "Keyframes",
    "LossInputs",
    "LossTerm",
    "MapPoints",
    "Observations",
    "PinholeCamera",
    "PluginSpec",
    "PrgbdError",
    "RefinementBatch",
    "Sequence",
    "SlamResult",
    "TrackingResult",
    "TrackingState",
    "Trajectory",
    "Verdict",
    "View",
    "__version__",
    "check_augmentation",
    "check_criterion",
    "check_depth_estimator",
    "check_loss",
    "check_sequence",
    "check_slam",
    "improve",
    "load_result",
    "make_augmentation",
    "make_criterion",
    "make_data",
    "make_depth",
    "make_loss",
    "make_sequences",
    "make_slam",
    "register_augmentation",
    "register_criterion",
    "register_data",
    "register_depth",
    "register_loss",
    "register_slam",
    "save_result",
    "to_evo",
]

if TYPE_CHECKING:
    from prgbd.core.augmentation import Augmentation
    from prgbd.core.criterion import Criterion, Evidence, Verdict
    from prgbd.core.data import Sequence
    from prgbd.core.depth import DepthEstimator
    from prgbd.core.errors import PrgbdError
    from prgbd.core.loss import LossInputs, LossTerm
    from prgbd.core.refinement_batch import RefinementBatch, View
    from prgbd.core.registry import (
        PluginSpec,
        make_augmentation,
        make_criterion,
        make_data,
        make_depth,
        make_loss,
        make_sequences,
        make_slam,
        register_augmentation,
        register_criterion,
        register_data,
        register_depth,
        register_loss,
        register_slam,
    )
    from prgbd.core.slam import GeometricSLAM, TrackingResult, TrackingState
    from prgbd.core.testing.conformance import check_depth_estimator, check_sequence, check_slam
    from prgbd.core.testing.refinement_checks import check_augmentation, check_criterion, check_loss
    from prgbd.core.types import (
        DepthPrediction,
        Frame,
        Keyframes,
        MapPoints,
        Observations,
        PinholeCamera,
        SlamResult,
        Trajectory,
    )
    from prgbd.core.wrappers import DepthWrapper
    from prgbd.io.export import load_result, save_result
    from prgbd.io.trajectory_files import to_evo
    from prgbd.loop.improve import improve
    from prgbd.loop.improvement import Improvement


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'prgbd' has no attribute '{name}'")
    value = getattr(importlib.import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
