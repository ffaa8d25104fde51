"""``posenet``: the chained motions of a pose network, as a baseline beside SLAM (Tiwari et al., ECCV 2020, Fig. 1)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import ConfigError, ContractError, WeightsError
from prgbd.core.option_ranges import Count
from prgbd.core.registry import REGISTRY
from prgbd.core.slam import GeometricSLAM, TrackingResult, TrackingState
from prgbd.core.types import (
    Frame,
    Keyframes,
    MapPoints,
    Observations,
    PinholeCamera,
    SlamResult,
    Trajectory,
)


class PoseNetworkOdometry(GeometricSLAM):
    """Visual odometry by a pose network alone: every motion between neighbours is predicted, and all are chained.

    There is no map, so nothing ever corrects a motion: errors add up. The scale is that of the depth network which the
    pose network was trained with.

    Args:
        depth: Id of the depth plug-in that the pose network belongs to, see ``DepthEstimator.pose_network``.
        weights: Its weights, with the pose network in them (Monodepth2: a folder with ``pose_encoder.pth`` and
            ``pose.pth`` besides the depth network's files).
        keyframe_every: Every such frame is a keyframe of the result.

    Raises:
        ConfigError: If no weights are given, the plug-in brings no pose network, or ``keyframe_every`` is below 1.
        WeightsError: If the weights hold no pose network.
    """

    modes: ClassVar[frozenset[str]] = frozenset({"mono"})

    def __init__(self, depth: str = "monodepth2", weights: str | Path | None = None, keyframe_every: Count = 1) -> None:
        if weights is None:
            raise ConfigError(
                "slam=posenet needs a trained pose network; set slam.weights to the folder of its weights, such as "
                "task=pretrain writes them."
            )
        self.keyframe_every = keyframe_every
        self._estimator: DepthEstimator = REGISTRY.make("depth", depth, weights=weights)
        self._pose = trained_pose_network(depth, self._estimator, weights).eval()
        self._camera: PinholeCamera | None = None
        self._begin()

    def _begin(self) -> None:
        self._previous: Tensor | None = None
        self._wTc = np.eye(4)
        self._rows: list[tuple[int, float, NDArray[np.float64]]] = []

    def reset(
        self, camera: PinholeCamera, mode: str, *, baseline: float | None = None, fps: float = 30.0, seed: int = 0
    ) -> None:
        """See ``GeometricSLAM.reset``; baseline, frame rate and seed are not used, and nothing is random."""
        if mode not in self.modes:
            raise ConfigError(f"posenet has no mode '{mode}', for it looks at images alone; use slam.mode=mono.")
        self._camera = camera
        self._begin()

    def track(self, frame: Frame) -> TrackingResult:
        """See ``GeometricSLAM.track``."""
        image = self._estimator.preprocess(frame.image)[None]
        if self._previous is not None:
            cTp = self._motion(self._previous, image, frame.index)
            self._wTc = self._wTc @ np.linalg.inv(cTp)
        self._previous = image
        is_keyframe = len(self._rows) % self.keyframe_every == 0
        self._rows.append((frame.index, frame.timestamp, self._wTc))
        return TrackingResult(TrackingState.OK, self._wTc, 0, is_keyframe)

    def finish(self) -> SlamResult:
        """See ``GeometricSLAM.finish``; the map is empty."""
        assert self._camera is not None, "finish before reset"
        index = np.array([row[0] for row in self._rows], np.int64)
        stamps = np.array([row[1] for row in self._rows], np.float64)
        wTc = np.array([row[2] for row in self._rows]).reshape(-1, 4, 4)
        chosen = slice(None, None, self.keyframe_every)
        keyframes = Keyframes(index[chosen], stamps[chosen], wTc[chosen], np.zeros(len(index[chosen]), np.int32))
        trajectory = Trajectory(index, stamps, wTc)
        nothing = np.zeros(0, np.int64)
        return SlamResult(
            camera=self._camera.undistorted(),
            mode="mono",
            frames=len(index),
            trajectory=trajectory,
            keyframes=keyframes,
            points=MapPoints(np.zeros((0, 3)), np.zeros((0, 3), np.uint8)),
            observations=Observations(nothing, nothing, np.zeros((0, 2), np.float32), np.zeros(0, np.float32)),
            states=[TrackingState.OK.value] * len(index),
            inliers=np.zeros(len(index), np.int32),
            online=trajectory,
            stats={"path_length": float(np.linalg.norm(np.diff(wTc[:, :3, 3], axis=0), axis=1).sum())},
        )

    def _motion(self, previous: Tensor, image: Tensor, index: int) -> NDArray[np.float64]:
        """Predict ``currentTprevious``, (4, 4) float64: the pair goes in in temporal order (Monodepth2)."""
        with torch.inference_mode():
            cTp = self._pose(previous, image)
        if tuple(cTp.shape) != (1, 4, 4) or not bool(torch.isfinite(cTp).all()):
            raise ContractError(
                f"The pose network of {type(self._estimator).__name__} gave no finite (1, 4, 4) motion at frame "
                f"{index}; check slam.weights."
            )
        motion = cTp[0].double().cpu().numpy()
        # The network computes in float32; the nearest rotation keeps thousands of chained ones rigid.
        U, _, Vt = np.linalg.svd(motion[:3, :3])
        motion[:3, :3] = U @ Vt
        motion[3] = (0.0, 0.0, 0.0, 1.0)
        return np.asarray(motion, np.float64)


def trained_pose_network(depth: str, estimator: DepthEstimator, weights: str | Path) -> nn.Module:
    """Return the pose network that came with an estimator's weights.

    Args:
        depth: Id of the depth plug-in.
        estimator: The estimator with ``weights`` loaded.
        weights: The weights, for messages.

    Raises:
        ConfigError: If the plug-in brings no pose network.
        WeightsError: If the weights hold none: it would be a fresh one, whose motions mean nothing.
    """
    pose = estimator.pose_network()
    if pose is None:
        raise ConfigError(f"The depth plug-in '{depth}' brings no pose network; choose slam.depth=monodepth2.")
    fresh: Any = REGISTRY.make("depth", depth).pose_network()
    own, untrained = pose.state_dict(), fresh.state_dict()
    if own.keys() == untrained.keys() and all(torch.equal(own[name], untrained[name]) for name in own):
        raise WeightsError(
            f"The weights {weights} of '{depth}' hold no pose network, which slam=posenet chains; choose weights that "
            "were stored with it (Monodepth2: pose_encoder.pth and pose.pth in the same folder)."
        )
    return pose
