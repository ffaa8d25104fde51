"""The figures that Tiwari et al. (ECCV 2020) published, to be put beside a run on the same data."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

METRICS = ("abs_rel", "sq_rel", "rmse", "rmse_log", "a1", "a2", "a3")

# Sequence: {system: (ATE RMSE in m or None for a tracking failure, Rel Tr in %, Rel Rot in deg/m)}
KITTI_POSE: dict[str, dict[str, tuple[float | None, float | None, float | None]]] = {
    "09": {
        "RGB ORB-SLAM": (18.34, 7.42, 0.004),
        "pRGBD-Initial": (12.21, 4.26, 0.011),
        "pRGBD-Refined": (11.97, 4.20, 0.010),
        "Monodepth2-M pose network": (55.47, 11.47, 0.032),
    },
    "10": {
        "RGB ORB-SLAM": (8.90, 5.85, 0.004),
        "pRGBD-Initial": (8.30, 5.55, 0.017),
        "pRGBD-Refined": (6.35, 4.40, 0.016),
        "Monodepth2-M pose network": (20.46, 7.73, 0.034),
    },
}
TUM_POSE: dict[str, dict[str, tuple[float | None, float | None, float | None]]] = {
    "walking_xyz": {
        "RGB ORB-SLAM": (None, None, None),
        "pRGBD-Initial": (0.23, None, None),
        "pRGBD-Refined": (0.09, None, None),
    },
    "large_cabinet_validation": {
        "RGB ORB-SLAM": (1.72, None, None),
        "pRGBD-Initial": (1.40, None, None),
        "pRGBD-Refined": (0.39, None, None),
    },
}
# Data plug-in: (test set, {system: the seven metrics})
DEPTH: dict[str, tuple[str, dict[str, tuple[float, ...]]]] = {
    "kitti_raw": (
        "KITTI Eigen test images",
        {
            "MonoDepth2-M": (0.117, 0.941, 4.889, 0.194, 0.873, 0.957, 0.980),
            "pRGBD-Refined": (0.113, 0.793, 4.655, 0.188, 0.874, 0.960, 0.983),
        },
    ),
    "kitti_odometry": (
        "KITTI odometry 09 and 10",
        {
            "MonoDepth2-M": (0.123, 0.703, 4.165, 0.188, 0.854, 0.956, 0.985),
            "pRGBD-Refined": (0.121, 0.649, 3.995, 0.184, 0.853, 0.960, 0.986),
        },
    ),
    "tum_rgbd": (
        "TUM RGB-D test sequences",
        {
            "MonoDepth2-M": (0.397, 0.848, 1.090, 0.719, 0.483, 0.722, 0.862),
            "pRGBD-Refined": (0.307, 0.341, 0.743, 0.655, 0.522, 0.766, 0.873),
        },
    ),
}
# KITTI Eigen after the first loop: (Sq Rel, RMSE), by the name of the loss configuration.
ABLATION: dict[str, tuple[float, float]] = {
    "no_depth_consistency": (0.958, 4.956),
    "no_depth_transfer": (0.955, 4.867),
    "no_photometric": (0.942, 4.855),
    "all": (0.931, 4.809),
}


def published_pose(data: str | None, sequence: str) -> dict[str, tuple[float | None, float | None, float | None]]:
    """Return the published pose figures of a sequence, empty where there are none."""
    if data == "kitti_odometry":
        return KITTI_POSE.get(sequence, {})
    if data == "tum_rgbd":
        return next((figures for name, figures in TUM_POSE.items() if sequence.endswith(name)), {})
    return {}


def published_depth(summary: dict[str, Any]) -> tuple[str, dict[str, tuple[float, ...]]] | None:
    """Return the published depth figures for the data of a run and the test set they belong to, or None.

    The figures are those of whole test sets, so they are given only for runs that evaluate a part of them.
    """
    data, sequences = summary.get("data"), [str(s) for s in summary.get("sequences") or []]
    if data == "kitti_odometry" and not {"09", "10"} & set(sequences):
        return None
    if data == "tum_rgbd" and not any(s.endswith(name) for s in sequences for name in TUM_POSE):
        return None
    return DEPTH.get(str(data))


def published_refinement(data: str | None, sequences: Iterable[str]) -> dict[str, float]:
    """Return what the paper's loops made of a set of test recordings, beside which a run's first and last loop stand.

    Args:
        data: Id of the data plug-in.
        sequences: The recordings whose mean is compared.

    Returns:
        ``ate_first`` and ``ate_last`` (m, means over the recordings; absent unless each of them is published),
        ``abs_rel_first`` and so on for the pre-trained network, ``abs_rel`` and so on for the refined one.
    """
    out: dict[str, float] = {}
    names = list(sequences)
    for key, system in (("ate_first", "pRGBD-Initial"), ("ate_last", "pRGBD-Refined")):
        errors = [published_pose(data, name).get(system, (None,))[0] for name in names]
        known = [error for error in errors if error is not None]
        if known and len(known) == len(names):
            out[key] = sum(known) / len(known)
    depth = published_depth({"data": data, "sequences": names})
    if depth is not None:
        out |= {f"{metric}_first": value for metric, value in zip(METRICS, depth[1]["MonoDepth2-M"], strict=True)}
        out |= dict(zip(METRICS, depth[1]["pRGBD-Refined"], strict=True))
    return out


def published_ablation(label: str) -> tuple[float, float] | None:
    """Return the published (Sq Rel, RMSE) for an ablation row whose label names a loss configuration, or None."""
    for name, figures in ABLATION.items():
        if any(part.split("=")[-1].strip() == name for part in label.split(",")) and "loss" in label:
            return figures
    return None
