"""Motion of the camera and of other movers along a closed path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d


@dataclass(frozen=True)
class ClosedPath:
    """A closed curve in the ground plane, sampled finely and passed at a given pace.

    Attributes:
        points: (N, 2) float64 x and z of points at equal distance along the curve; the last is not repeated.
        step: Metres between two points.
    """

    points: NDArray[np.float64]
    step: float

    @property
    def length(self) -> float:
        """Metres once around."""
        return self.step * len(self.points)

    def at(self, distance: NDArray[np.float64], aside: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Return the (M, 2) points after ``distance`` metres, ``aside`` metres to the right of the curve."""
        forward = self.forward(distance)
        right = np.stack([forward[:, 1], -forward[:, 0]], axis=1)
        return self._interpolate(self.points, distance) + np.asarray(aside, np.float64).reshape(-1, 1) * right

    def forward(self, distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (M, 2) unit tangents after ``distance`` metres."""
        tangents = np.roll(self.points, -1, axis=0) - np.roll(self.points, 1, axis=0)
        found = self._interpolate(tangents, distance)
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    def curvature(self) -> NDArray[np.float64]:
        """Return the (N,) absolute curvature at the points, 1/m."""
        tangents = np.roll(self.points, -1, axis=0) - np.roll(self.points, 1, axis=0)
        heading = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
        turn = np.angle(np.exp(1j * (np.roll(heading, -1) - np.roll(heading, 1))))
        return np.abs(turn) / (2 * self.step)

    def _interpolate(self, values: NDArray[np.float64], distance: NDArray[np.float64]) -> NDArray[np.float64]:
        place = np.mod(np.asarray(distance, np.float64) / self.step, len(values))
        index = place.astype(np.int64)
        part = (place - index)[:, None]
        return values[index % len(values)] * (1 - part) + values[(index + 1) % len(values)] * part


def closed_path(corners: NDArray[np.float64], smoothing: float, step: float = 0.1) -> ClosedPath:
    """Return a closed path through a polygon, resampled evenly and smoothed over ``smoothing`` metres."""
    for sigma in (smoothing / step, 0.0):
        loop = np.concatenate([corners, corners[:1]])
        along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
        count = max(8, round(along[-1] / step))
        places = np.linspace(0, along[-1], count, endpoint=False)
        corners = np.stack([np.interp(places, along, loop[:, i]) for i in range(2)], axis=1)
        if sigma:
            corners = gaussian_filter1d(corners, sigma, axis=0, mode="wrap")
    return ClosedPath(corners, along[-1] / count)


def rounded_rectangle(half_x: float, half_z: float, radius: float, clockwise: bool) -> NDArray[np.float64]:
    """Return the corner points (M, 2) of a rectangle around the origin with round corners."""
    parts = []
    for quarter, (sx, sz) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angles = np.pi / 2 * (quarter + np.linspace(0, 1, 24))
        centre = np.array([sx * (half_x - radius), sz * (half_z - radius)])
        parts.append(centre + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    points = np.concatenate(parts)
    return points[::-1].copy() if clockwise else points


def travelled(path: ClosedPath, frames: int, cruise: float, slowest: float, turn_limit: float) -> NDArray[np.float64]:
    """Return the distance travelled at each frame, (frames,) metres, starting at 0.

    Args:
        path: The path.
        frames: Number of frames; it changes how far the motion goes, not its pace.
        cruise: Metres per frame on the straight.
        slowest: Metres per frame in the tightest bends.
        turn_limit: Largest change of heading per frame, radians.
    """
    limit = np.clip(turn_limit / np.maximum(path.curvature(), 1e-6), slowest, cruise)
    # Braking before and accelerating after a bend.
    pace = gaussian_filter1d(limit, 4 * cruise / path.step, mode="wrap")
    out = np.zeros(frames)
    place = 0.0
    for i in range(1, frames):
        place += pace[int(place / path.step) % len(pace)]
        out[i] = place
    return out


def sway(rng: np.random.Generator, steps: NDArray[np.float64], period: float, waves: int = 4) -> NDArray[np.float64]:
    """Return smooth random motion within about [-1, 1] at the given steps; it never repeats exactly."""
    periods = period * rng.uniform(0.6, 1.9, waves)
    phases = rng.uniform(0, 2 * np.pi, waves)
    return np.sin(2 * np.pi * steps[:, None] / periods + phases).sum(axis=1) / np.sqrt(2 * waves)


def poses_looking(
    position: NDArray[np.float64],
    yaw: NDArray[np.float64],
    pitch: NDArray[np.float64],
    roll: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return camera-to-world poses (N, 4, 4).

    Args:
        position: (N, 3) metres.
        yaw: (N,) heading, radians, 0 along +z and growing towards +x.
        pitch: (N,) radians, positive looks up.
        roll: (N,) radians, positive turns the camera clockwise.
    """
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    turn = np.array([[cy, zero, sy], [zero, one, zero], [-sy, zero, cy]]).transpose(2, 0, 1)
    nod = np.array([[one, zero, zero], [zero, cp, -sp], [zero, sp, cp]]).transpose(2, 0, 1)
    bank = np.array([[cr, -sr, zero], [sr, cr, zero], [zero, zero, one]]).transpose(2, 0, 1)
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :3, :3] = turn @ nod @ bank
    poses[:, :3, 3] = position
    return poses
