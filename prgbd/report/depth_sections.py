"""The sections of the page about depth: maps before and after under a slider, and errors by cap, distance and loop."""

from __future__ import annotations

import base64
import json
from html import escape

import numpy as np
from numpy.typing import NDArray

from prgbd.report import pictures, range_figures
from prgbd.report.drawing import figure_html
from prgbd.report.reading import DepthSamples, Run
from prgbd.report.words import number


def depth_section(run: Run, width: int, most: int) -> str:
    """Return depth maps before and after beside image and truth, as pictures no wider than ``width`` pixels."""
    rows = pictures.depth_rows(first_and_last_samples(run), most)
    if not rows:
        return ""
    html = "<h2>Depth</h2>"
    scaled = (
        "to the truth" if any(row.truth is not None for row in rows) else "to the first prediction (there is no truth)"
    )
    lede = f"Predictions are median-scaled {scaled}; each frame has one colour scale for all its depth maps."
    html += f'<p class="lede">{lede}</p>'
    return html + "".join(_frame(row, width) for row in rows)


def first_and_last_samples(run: Run) -> list[tuple[str, DepthSamples]]:
    """Return name and depth samples of the first and of the kept loop, as far as they are there."""
    found = [(run.label(loop), run.samples(loop)) for loop in run.kept_loops]
    known = [(label, samples) for label, samples in found if samples is not None and len(samples.keys)]
    return known if len(known) < 2 else [known[0], known[-1]]


# What can be compared by a slider: name, picture on the left, picture on the right.
PAIRS = (
    ("Depth before | after", "depth0", "depth1"),
    ("Error before | after", "error0", "error1"),
    ("Image | depth", "image", "depth1"),
    ("Image | depth", "image", "depth0"),
    ("Truth | depth", "truth", "depth1"),
)


def depth_ranges_section(run: Run) -> str:
    """Return the depth errors by cap and by the distance of the truth, for the first and the last network."""
    found = range_figures.range_curves(run)
    drawn = [figure_html(curve.figure, curve.label, "", f"r{i}-") for i, curve in enumerate(found)]
    if not drawn:
        return ""
    lede = (
        "By cap: the whole protocol with the truth cut off at that depth, means over images. By distance: all pixels "
        "whose true depth lies in that range, after the scaling of the headline cap. By loop: the first of these, with "
        "one line per cap."
    )
    return f'<h3>Depth by range</h3><p class="lede">{lede}</p><div class="grid medium">{"".join(drawn)}</div>'


def _frame(row: pictures.DepthRow, width: int) -> str:
    """Return one frame's pictures: image, truth and predictions in a line, the errors below their predictions."""
    tiles = [_tile(row.image, "image", f"{row.sequence} frame {row.frame}".strip(), width, role="image")]
    if row.truth is not None:
        tiles.append(_tile(row.truth, "truth", "", width, role="truth"))
    start = len(tiles) + 1
    tiles += [
        _tile(p.picture, p.label, _abs_rel(p.abs_rel), width, role=f"depth{i}") for i, p in enumerate(row.predictions)
    ]
    across = len(tiles)
    errors = [(p.label, p.error_picture) for p in row.predictions if p.error_picture is not None]
    tiles += [
        _tile(e, f"error, {n}", "", width, "" if i else "newline", f"error{i}") for i, (n, e) in enumerate(errors)
    ]
    style = f"--across:{across};--start:{start}"
    single = len(row.predictions) == 1
    pairs = [pair for pair in PAIRS if (pair[2] == "depth0") == single]
    given = escape(json.dumps(pairs), quote=True)
    inside = f'<div class="tiles" style="{style}">{"".join(tiles)}</div>{_bars(row)}'
    return f'<figure class="frame" data-pairs="{given}">{inside}</figure>'


def _abs_rel(value: float | None) -> str:
    return "" if value is None else f"Abs Rel {number(value)}"


def _tile(picture: NDArray[np.uint8], name: str, detail: str, width: int, kind: str = "", role: str = "") -> str:
    data = base64.b64encode(pictures.to_jpeg(picture, width)).decode()
    text = f"<b>{escape(name)}</b>" + (f" {escape(detail)}" if detail else "")
    image = f'<img data-role="{role}" alt="{escape(name, quote=True)}" src="data:image/jpeg;base64,{data}">'
    return f'<div class="{kind}">{image}<p>{text}</p></div>'


def _bars(row: pictures.DepthRow) -> str:
    unit = " m" if row.truth is not None else ""

    def bar(name: str) -> str:
        return f'<i class="bar" style="background:{pictures.gradient(name)}"></i>'

    html = f"<span>depth {number(row.near)}{unit}{bar(pictures.DEPTH_MAP)}{number(row.far)}{unit}</span>"
    if row.truth is not None:
        html += f"<span>relative error 0{bar(pictures.ERROR_MAP)}{pictures.ERROR_LIMIT:.0%} and more</span>"
        html += "<span>grey: truth unknown</span>"
    return f'<div class="bars">{html}</div>'
