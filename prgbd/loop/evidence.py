"""What a SLAM run says of the network whose depth it used, without any label."""

from __future__ import annotations

from collections.abc import Sequence as Many

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from prgbd.core.criterion import Evidence
from prgbd.core.multiview import reprojection_errors
from prgbd.core.types import DepthPrediction, PinholeCamera, SlamResult
from prgbd.core.undistortion import Undistorter
from prgbd.evaluation.triangulated_depth import disagreement
from prgbd.functional.losses import photometric_loss
from prgbd.loop.depth_figures import evenly
from prgbd.loop.sensing import DepthSensor
from prgbd.training.supervision import clean_observations

FRAMES = 32
"""Frames per recording whose photometric error is taken."""

Floats = NDArray[np.float64]


def evidence(result: SlamResult, sensor: DepthSensor, frame_gap: int = 1) -> Evidence:
    """Measure how well depth, poses and images of one recording fit together; all of it is free of scale.

    Args:
        result: What SLAM made of the recording with the network's depth.
        sensor: The network on the recording.
        frame_gap: Frames between an image and those that are warped to it.

    Returns:
        The evidence; its photometric error is pre-training's, without mask.
    """
    tracked = result.inliers[np.asarray([str(state) == "ok" for state in result.states], bool)]
    seen = clean_observations(result)
    errors = reprojection_errors(result.camera, result.keyframes, result.points, seen)
    within, between = disagreement(result, seen)
    return {
        "tracked": len(result.trajectory) / max(result.frames, 1),
        "maps": len(np.unique(result.keyframes.map_id)),
        "inliers": float(np.mean(tracked)) if len(tracked) else None,
        "reprojection": float(np.median(errors)) if len(errors) else None,
        "disagreement": within,
        "scale_wander": between,
        "photometric": photometric_errors(result, sensor, frame_gap),
    }


def photometric_errors(result: SlamResult, sensor: DepthSensor, frame_gap: int = 1) -> dict[str, float]:
    """Return the photometric error of evenly spaced frames, the same in every loop, that have their neighbours' poses.

    Keyframes are left out, for the network learns from them.
    """
    pose = dict(zip(result.trajectory.frame_index.tolist(), result.trajectory.wTc, strict=True))
    keyframes = set(result.keyframes.frame_index.tolist())
    errors = {}
    for frame in evenly(len(sensor), FRAMES).tolist():
        neighbours = [frame - frame_gap, frame + frame_gap]
        if frame not in keyframes and all(index in pose for index in (frame, *neighbours)):
            sTt = [np.linalg.inv(pose[index]) @ pose[frame] for index in neighbours]
            errors[str(frame)] = _photometric_error(sensor, result.camera, frame, neighbours, sTt)
    return errors


def _photometric_error(
    sensor: DepthSensor, camera: PinholeCamera, frame: int, neighbours: Many[int], sTt: Many[Floats]
) -> float:
    """Warp with the camera that SLAM's poses belong to, which self-calibration may have refined."""
    estimator, sequence = sensor.estimator, sensor.sequence
    height, width = estimator.input_size
    lens = Undistorter(camera)
    images = (lens.image(sequence.frame(i).image) for i in (frame, *neighbours))
    target, *sources = (estimator.preprocess(image).cpu()[None] for image in images)
    depth = sensor.depth(frame)
    moved = lens.depth(depth)
    # What the camera did not see is black in every image; any depth will do there.
    inverse = cv2.resize(1 / np.where(moved > 0, moved, depth), (width, height), interpolation=cv2.INTER_AREA)
    K = torch.from_numpy(camera.resized(width, height).K).float()[None]
    transforms = [torch.from_numpy(T).float()[None] for T in sTt]
    prediction = DepthPrediction((torch.from_numpy(1 / inverse)[None, None],))
    with torch.inference_mode():
        return float(photometric_loss(prediction, target, sources, K, transforms, automask=False))
