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

MOST_MAPS = 2
MOST_POINTS = 6000  # per map; 9 bytes each, and as many as a phone draws while it is turned


@dataclass(frozen=True)
class View:
    """Trajectories and map, to be turned and as a drawing from above.

    Attributes:
        drawing: For paper and for browsers without scripts.
        scene: What ``static/view.js`` draws; each path in it has a box that shows and hides it.
    """

    drawing: Drawing
    scene: dict[str, Any]


def view(paths: Sequence[Path3D], axes: tuple[int, int], unit: str, drawing: Drawing) -> View:
    """Return trajectories and map for the page.

    Args:
        paths: The paths; of their maps the last ``MOST_MAPS`` are shown.
        axes: World axes to the right and up in the view from above, see ``figures.horizontal_axes``.
        unit: Unit of lengths.
        drawing: The same from above.
    """
    return View(drawing, _scene(paths, axes, unit))


def _scene(paths: Sequence[Path3D], axes: tuple[int, int], unit: str) -> dict[str, Any]:
    """Turn everything to x right, y away, z up around the middle of paths and maps."""
    right, away = axes
    up = 3 - right - away
    turn = np.zeros((3, 3))
    turn[0, right] = turn[1, away] = turn[2, up] = 1
    turn[2] *= np.linalg.det(turn)  # the view is not mirrored
    maps = [(f"p{i}", path.map) for i, path in enumerate(paths) if path.map is not None][-MOST_MAPS:]
    none = np.zeros((0, 3))
    low, high = extent(
        np.concatenate([none, *(path.xyz for path in paths)]) @ turn.T,
        np.concatenate([none, *(points.xyz for _, points in maps)]) @ turn.T,
    )
    middle, reach = (low + high) / 2, max(float((high - low).max()), 1e-6)
    digits = max(0, 4 - int(np.floor(np.log10(reach))))
    drawn = []
    for i, path in enumerate(paths):
        (line,) = broken(path.frames, path.xyz @ turn.T - middle)
        points = [None if np.isnan(p).any() else p for p in np.round(line, digits).tolist()]
        colour = None if path.colour == INK else path.colour  # the page's ink, which follows light and dark
        drawn.append({"name": f"p{i}", "label": path.label, "colour": colour, "xyz": points})
    packed = [_packed(name, points.xyz @ turn.T - middle, points.rgb, reach) for name, points in maps]
    size = [1.15 * max(float(high[k] - low[k]), 0.3 * reach) for k in (0, 1)]
    return {"unit": unit, "size": size, "paths": drawn, "clouds": [cloud for cloud in packed if cloud]}


def _packed(name: str, xyz: NDArray[np.float64], rgb: NDArray[np.uint8], reach: float) -> dict[str, Any] | None:
    """Points as 16-bit numbers; those far outside are left out, for they would coarsen all the others."""
    near = np.flatnonzero((np.abs(xyz) < 2 * reach).all(axis=1))  # a NaN is not near
    near = near[:: max(1, -(-len(near) // MOST_POINTS))]
    if not len(near):
        return None
    unit = 2 * reach / 32767
    numbers = np.round(xyz[near] / unit).astype("<i2")
    colours = np.ascontiguousarray(rgb[near], np.uint8)
    packed = {"xyz": base64.b64encode(numbers.tobytes()), "rgb": base64.b64encode(colours.tobytes())}
    return {"of": name, "unit": unit, **{key: value.decode() for key, value in packed.items()}}
