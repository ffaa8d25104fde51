"""Bringing an estimated trajectory into the frame (and scale) of another one."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError

ALIGNMENTS = ("sim3", "se3", "none")


@dataclass(frozen=True)
class Alignment:
    """A similarity transform ``x -> scale * rotation @ x + translation`` that maps an estimate onto a reference.

    Attributes:
        rotation: (3, 3) float64.
        translation: (3,) float64 metres.
        scale: Factor on the estimate's lengths.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    scale: float = 1.0

    def points(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points, (N, 3), into the reference frame."""
        return self.scale * np.asarray(xyz, np.float64) @ self.rotation.T + self.translation

    def poses(self, wTc: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map camera-to-world poses, (N, 4, 4), into the reference frame; they stay rigid."""
        out = np.array(wTc, np.float64)
        out[:, :3, :3] = self.rotation @ out[:, :3, :3]
        out[:, :3, 3] = self.points(wTc[:, :3, 3])
        return out


def fit_alignment(estimate: NDArray[np.float64], reference: NDArray[np.float64], kind: str = "sim3") -> Alignment:
    """Fit the least-squares alignment of corresponding positions (Umeyama 1991, by evo).

    On a perfectly straight path, where evo refuses, the rotation about the path is not determined and any of the
    equally good ones is taken: the residual is the same for all of them. A path that stands still gets the
    identity rotation and scale 1.

    Args:
        estimate: (N, 3) positions to be aligned.
        reference: (N, 3) positions to align to.
        kind: ``sim3`` (rotation, translation, scale), ``se3`` (no scale) or ``none``.

    Raises:
        ConfigError: If ``kind`` is unknown.
    """
    if kind not in ALIGNMENTS:
        raise ConfigError(f"There is no alignment '{kind}'; choose one of {', '.join(ALIGNMENTS)}.")
    if kind == "none":
        return Alignment(np.eye(3), np.zeros(3))
    from evo.core.geometry import GeometryException, umeyama_alignment

    x, y = np.asarray(estimate, np.float64), np.asarray(reference, np.float64)
    try:
        rotation, translation, scale = umeyama_alignment(x.T, y.T, with_scale=kind == "sim3")
    except GeometryException:
        return _fit_degenerate(x, y, kind)
    return Alignment(rotation, translation, float(scale))


def _fit_degenerate(x: NDArray[np.float64], y: NDArray[np.float64], kind: str) -> Alignment:
    from scipy.spatial.transform import Rotation

    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    dx, dy = x - mean_x, y - mean_y
    rotation, scale = np.eye(3), 1.0
    if min(np.abs(dx).max(initial=0.0), np.abs(dy).max(initial=0.0)) > 1e-9:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "not uniquely defined" is what we are here for
            rotation = Rotation.align_vectors(dy, dx)[0].as_matrix()
        if kind == "sim3":
            scale = float(np.sum(dy * (dx @ rotation.T)) / np.sum(dx * dx))
    return Alignment(rotation, mean_y - scale * rotation @ mean_x, scale)
