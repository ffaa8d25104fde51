"""The interactive view of trajectories and map: its data; ``static/view.js`` draws it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.report.drawing import INK, Drawing, broken
from prgbd.report.figures import Path3D, extent

MOST_POINTS = 6000  # per cloud; 9 bytes each, and as many as a phone draws while it is turned


@dataclass(frozen=True)
class Cloud:
    """A map to draw.

    Attributes:
        of: Name of the path that it was made with; it is shown and hidden with it.
        xyz: (P, 3) metres in the common frame.
        rgb: (P, 3) uint8.
    """

    of: str
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]


@dataclass(frozen=True)
class View:
    """Trajectories and map, to be turned and as a drawing from above.

    Attributes:
        drawing: For paper and for browsers without scripts.
        scene: What ``static/view.js`` draws.
        toggles: Key in the scene, label and CSS colour of each box that shows and hides.
    """

    drawing: Drawing
    scene: dict[str, Any]
    toggles: list[tuple[str, str, str]]


def view(paths: Sequence[Path3D], clouds: Sequence[Cloud], axes: tuple[int, int], unit: str, drawing: Drawing) -> View:
    """Return trajectories and map for the page.

    Args:
        paths: The paths; a colour of ``INK`` marks the truth.
        clouds: Maps, each belonging to a path.
        axes: World axes to the right and up in the view from above, see ``figures.horizontal_axes``.
        unit: Unit of lengths.
        drawing: The same from above.
    """
    shown = _scene(paths, clouds, axes, unit)
    shades = ["var(--ink)" if path.colour == INK else path.colour for path in paths]
    toggles = [(f"p{i}", path.label, shade) for i, (path, shade) in enumerate(zip(paths, shades, strict=True))]
    toggles += [("points", "map points", "#8a93a3")] if shown["clouds"] else []
    return View(drawing, shown, toggles)


def _scene(paths: Sequence[Path3D], clouds: Sequence[Cloud], axes: tuple[int, int], unit: str) -> dict[str, Any]:
    """Turn everything to x right, y away, z up around the middle of paths and maps."""
    right, away = axes
    up = 3 - right - away
    turn = np.zeros((3, 3))
    turn[0, right] = turn[1, away] = turn[2, up] = 1
    turn[2] *= np.linalg.det(turn)  # the view is not mirrored
    none = np.zeros((0, 3))
    low, high = extent(
        np.concatenate([none, *(path.xyz for path in paths)]) @ turn.T,
        np.concatenate([none, *(cloud.xyz for cloud in clouds)]) @ turn.T,
    )
    middle, reach = (low + high) / 2, max(float((high - low).max()), 1e-6)
    digits = max(0, 4 - int(np.floor(np.log10(reach))))
    drawn = []
    for i, path in enumerate(paths):
        (line,) = broken(path.frames, path.xyz @ turn.T - middle)
        points = [None if np.isnan(p).any() else p for p in np.round(line, digits).tolist()]
        drawn.append({"name": f"p{i}", "colour": None if path.colour == INK else path.colour, "xyz": points})
    names = {path.label: f"p{i}" for i, path in enumerate(paths)}
    packed = [_packed(names[cloud.of], cloud, turn, middle, reach) for cloud in clouds if cloud.of in names]
    size = [1.15 * max(float(high[k] - low[k]), 0.3 * reach) for k in (0, 1)]
    return {"unit": unit, "size": size, "paths": drawn, "clouds": [cloud for cloud in packed if cloud]}


def _packed(
    name: str, cloud: Cloud, turn: NDArray[np.float64], middle: NDArray[np.float64], reach: float
) -> dict[str, Any] | None:
    """Points as 16-bit numbers; those far outside are left out, for they would coarsen all the others."""
    xyz = cloud.xyz @ turn.T - middle
    near = np.flatnonzero((np.abs(xyz) < 2 * reach).all(axis=1))  # a NaN is not near
    near = near[:: max(1, -(-len(near) // MOST_POINTS))]
    if not len(near):
        return None
    unit = 2 * reach / 32767
    numbers = np.round(xyz[near] / unit).astype("<i2")
    colours = np.ascontiguousarray(cloud.rgb[near], np.uint8)
    packed = {"xyz": base64.b64encode(numbers.tobytes()), "rgb": base64.b64encode(colours.tobytes())}
    return {"of": name, "unit": unit, **{key: value.decode() for key, value in packed.items()}}
