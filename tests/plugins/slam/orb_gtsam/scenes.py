"""Made-up scenes with known truth for the tests of the numerical parts of ``orb_gtsam``."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleProblem

CAMERA = (700.0, 700.0, 600.0, 180.0, 380.0)


def project(cTw: np.ndarray, xyz: np.ndarray, camera: tuple[float, ...] = CAMERA) -> np.ndarray:
    """Return (u, v, u_right) by the book: an independent reference for the compiled code."""
    fx, fy, cx, cy, bf = camera
    x, y, z = (xyz @ cTw[:3, :3].T + cTw[:3, 3]).T
    u = fx * x / z + cx
    return np.stack([u, fy * y / z + cy, u - bf / z], axis=1)


def numerical_jacobian(function, size: int, step: float = 1e-6) -> np.ndarray:
    """Return central differences of a vector-valued function at zero, one column per parameter."""
    columns = []
    for k in range(size):
        d = np.zeros(size)
        d[k] = step
        columns.append((function(d) - function(-d)) / (2 * step))
    return np.stack(columns, axis=1)


@dataclass
class Scene:
    """A drive past points: truth, a disturbed first guess, and observations of which ``bad`` ones are wrong."""

    cTw: np.ndarray
    xyz: np.ndarray
    cTw0: np.ndarray
    xyz0: np.ndarray
    fixed: np.ndarray
    kf: np.ndarray
    pt: np.ndarray
    uvr: np.ndarray
    inv_sigma2: np.ndarray
    bad: np.ndarray

    @property
    def problem(self) -> BundleProblem:
        """The problem as it is now."""
        return BundleProblem(self.cTw0, self.fixed, self.xyz0, self.kf, self.pt, self.uvr, self.inv_sigma2, CAMERA)

    def only(self, rows: np.ndarray) -> BundleProblem:
        """The problem with these observations alone."""
        columns = {"pose_row": self.kf, "point_row": self.pt, "uvr": self.uvr, "inv_sigma2": self.inv_sigma2}
        return replace(self.problem, **{name: column[rows] for name, column in columns.items()})


def drive(
    keyframes: int = 8, points: int = 250, noise: float = 0.0, outliers: float = 0.0, mono: float = 0.0, seed: int = 0
) -> Scene:
    """Make a scene; the first two poses are fixed at their true place."""
    rng = np.random.default_rng(seed)
    cTw = np.stack([exp_se3(np.array([0, 0.01 * k, 0.002 * k, 0.02 * k, 0, -0.6 * k])) for k in range(keyframes)])
    xyz = np.stack([rng.uniform(-7, 7, points), rng.uniform(-2, 2, points), rng.uniform(8, 22, points)], axis=1)
    kf, pt, uvr = [], [], []
    for k in range(keyframes):
        seen = project(cTw[k], xyz)
        depth = xyz @ cTw[k, 2, :3] + cTw[k, 2, 3]
        inside = (depth > 2) & np.all((seen[:, :2] > 0) & (seen[:, :2] < [1200, 360]), axis=1) & (seen[:, 2] > 0)
        rows = np.flatnonzero(inside)
        kf.append(np.full(len(rows), k))
        pt.append(rows)
        uvr.append(seen[rows])
    kf, pt, uvr = np.concatenate(kf), np.concatenate(pt), np.concatenate(uvr)
    octave = rng.integers(0, 4, len(kf))
    uvr = uvr + noise * 1.2 ** octave[:, None] * rng.standard_normal(uvr.shape)
    bad = rng.random(len(kf)) < outliers
    uvr[bad, :2] += rng.uniform(20, 60, (int(bad.sum()), 2))
    uvr[rng.random(len(kf)) < mono, 2] = -1
    fixed = np.arange(keyframes) < 2
    shake = rng.normal(0, [0.002] * 3 + [0.03] * 3, (keyframes, 6)) * ~fixed[:, None]
    cTw0 = np.stack([exp_se3(xi) @ T for xi, T in zip(shake, cTw, strict=True)])
    xyz0 = xyz + rng.normal(0, 0.05, xyz.shape)
    return Scene(cTw, xyz, cTw0, xyz0, fixed, kf, pt, uvr, 1.44 ** -octave.astype(float), bad)
