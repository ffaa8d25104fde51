"""The interactive view of trajectories and map: its data as JSON and its element; ``static/view.js`` draws it."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.report.drawing import INK, broken
from prgbd.report.figures import Path3D

MOST_POINTS = 6000  # per cloud; 9 bytes each, and as many as a phone draws while it is turned
FAR = 50  # times the extent of the paths that points may lie away
SCRIPTS = ("view.js", "slider.js")


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


def scripts() -> str:
    """Return the page's scripts as one element."""
    files = resources.files("prgbd.report") / "static"
    text = "\n".join((files / name).read_text(encoding="utf-8").replace('"use strict";\n', "") for name in SCRIPTS)
    return f'<script>"use strict";\n{text}</script>'


def safe_json(data: Any) -> str:
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def view_html(paths: Sequence[Path3D], clouds: Sequence[Cloud], axes: tuple[int, int], unit: str, label: str) -> str:
    """Return the element of an interactive view; without scripts it is not shown.

    Args:
        paths: The paths; a colour of ``INK`` marks the truth.
        clouds: Maps, each belonging to a path.
        axes: World axes to the right and up in the view from above, see ``figures.horizontal_axes``.
        unit: Unit of lengths.
        label: Description for screen readers.
    """
    scene = _scene(paths, clouds, axes, unit)
    toggles = "".join(_toggle(f"p{i}", path.label, path.colour) for i, path in enumerate(paths))
    if scene["clouds"]:
        toggles += _toggle("points", "map points", "#8a93a3")
    buttons = "".join(
        f'<button type="button" data-view="{view}">{text}</button>'
        for view, text in (("top", "From above"), ("3d", "3D"))
    )
    return (
        f'<div class="view3d live"><div class="choices">{buttons}</div>'
        f'<canvas tabindex="0" role="img" aria-label="{escape(label, quote=True)}"></canvas>'
        f'<div class="toggles">{toggles}</div>'
        '<p class="hint">Drag to move (3D: to turn; Shift or two fingers to move). Pinch, + and −, or the wheel '
        "after a click to zoom; double click to start again.</p>"
        f'<script type="application/json">{safe_json(scene)}</script></div>'
    )


def _toggle(name: str, label: str, colour: str) -> str:
    shade = "var(--ink)" if colour == INK else colour
    return (
        f'<label><input type="checkbox" checked data-show="{name}"><i style="background:{shade}"></i>'
        f"{escape(label)}</label>"
    )


def _scene(paths: Sequence[Path3D], clouds: Sequence[Cloud], axes: tuple[int, int], unit: str) -> dict[str, Any]:
    """Turn everything to x right, y away, z up around the middle of the paths."""
    right, away = axes
    up = 3 - right - away
    turn = np.zeros((3, 3))
    turn[0, right] = turn[1, away] = turn[2, up] = 1
    turn[2] *= np.linalg.det(turn)  # the view is not mirrored
    positions = np.concatenate([path.xyz for path in paths if len(path.xyz)] or [np.zeros((1, 3))]) @ turn.T
    low, high = positions.min(axis=0), positions.max(axis=0)
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
    """Points as 16-bit numbers; those far outside are left out, for they would coarsen all the others.

    A camera that turns on the spot has nearly all of its map far outside; there the map decides what is far.
    """
    xyz = cloud.xyz @ turn.T - middle
    away = np.abs(xyz).max(axis=1)[np.isfinite(xyz).all(axis=1)]
    if len(away) and np.median(away) > 2 * reach:
        reach = min(float(np.quantile(away, 0.9)) / 2, FAR * reach)
    near = np.flatnonzero(np.isfinite(xyz).all(axis=1) & (np.abs(xyz) < 2 * reach).all(axis=1))
    near = near[:: max(1, -(-len(near) // MOST_POINTS))]
    if not len(near):
        return None
    unit = 2 * reach / 32767
    numbers = np.round(xyz[near] / unit).astype("<i2")
    colours = np.ascontiguousarray(cloud.rgb[near], np.uint8)
    packed = {"xyz": base64.b64encode(numbers.tobytes()), "rgb": base64.b64encode(colours.tobytes())}
    return {"of": name, "unit": unit, **{key: value.decode() for key, value in packed.items()}}
