"""How figures look, and how they become files: PNG, PDF, and SVG that follows the theme of a page.

Figures are made without pyplot, so nothing global is touched and no display is needed. Ink, grid and secondary text
have one colour each, which the page replaces by its own so that figures follow light and dark.
"""

from __future__ import annotations

import io
import re
import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID = "#010203", "#6e7072", "#d9dadb"
LOOP_COLOURS = ("#e0783a", "#c2528b", "#7a5fd0", "#2f7fc8", "#12998b")
BASELINE_COLOURS = ("#7d8794", "#9a8032")
WIDTH = 5.2  # inches; small enough that labels stay readable on a phone
MOST_POINTS = 1500  # per line; more cannot be seen and only makes the file large

STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "axes.edgecolor": GRID,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    **dict.fromkeys(("axes.labelcolor", "xtick.color", "ytick.color"), MUTED),
    **{f"{axis}tick.{kind}.size": 0 for axis in "xy" for kind in ("major", "minor")},
    **dict.fromkeys(("text.color", "axes.titlecolor", "legend.labelcolor"), INK),
    "lines.linewidth": 1.7,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "prgbd",
    **dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor"), "none"),
}


def loop_colours(count: int) -> list[str]:
    """Return one colour per loop, from the first (warm) to the last (cool)."""
    if count <= 1:
        return [LOOP_COLOURS[3]] * count
    if count == 2:
        return [LOOP_COLOURS[0], LOOP_COLOURS[3]]
    from matplotlib.colors import LinearSegmentedColormap, to_hex

    ramp = LinearSegmentedColormap.from_list("loops", LOOP_COLOURS)
    return [to_hex(ramp(i / (count - 1))) for i in range(count)]


def new_figure(
    height: float, rows: int = 1, columns: int = 1, width: float = WIDTH, **options: Any
) -> tuple[Figure, Any]:
    """Return an empty figure, sizes in inches, and its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


# What makes the same figure the same bytes.
_METADATA: dict[str, dict[str, None]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {},
}


def to_bytes(figure: Figure, suffix: str) -> bytes:
    """Render as ``svg``, as ``pdf`` with text that can be searched, or as ``png`` on white, 300 dots per inch."""
    buffer = io.BytesIO()
    options: dict[str, Any] = {"facecolor": "white", "dpi": 300} if suffix == "png" else {}
    with matplotlib.rc_context({**STYLE, "pdf.fonttype": 42}):
        figure.savefig(buffer, format=suffix, metadata=_METADATA[suffix], **options)
    return buffer.getvalue()


@dataclass(frozen=True)
class Drawing:
    """A figure for the page, and where it has a name for a file, too.

    Attributes:
        label: Description for screen readers, unique on the page.
        figure: The figure.
        caption: Words below it.
        name: Of the file, such as ``abs_rel-by-cap``.
    """

    label: str
    figure: Figure
    caption: str = ""
    name: str = ""

    @cached_property
    def svg(self) -> Markup:
        """The figure as an element for HTML that follows the page's theme."""
        return inline_svg(to_bytes(self.figure, "svg"), self.label)


def inline_svg(svg: bytes, label: str) -> Markup:
    """Return an SVG as an element for HTML that follows the page's theme.

    Args:
        svg: What ``to_bytes`` returned.
        label: Description for screen readers, unique on the page, so that references of several figures do not meet.
    """
    prefix = f"f{zlib.crc32(label.encode()):08x}-"
    text = svg.decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    text = re.sub(r' id="([^"]+)"', lambda m: f' id="{prefix}{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r'(href="#|url\(#)([^")]+)', rf"\g<1>{prefix}\2", text)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px var(--sans)", text)
    for colour, name in ((INK, "ink"), (MUTED, "muted"), (GRID, "grid")):
        text = text.replace(colour, f"var(--{name})")
    text = re.sub(r' (?:width|height)="[\d.]+pt"', "", text, count=2)
    return Markup(text.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1))


def broken(frames: NDArray[np.int64], *columns: NDArray[Any]) -> list[NDArray[np.float64]]:
    """Thin out columns to ``MOST_POINTS`` and put NaN where frames are missing, so that no line bridges a gap."""
    frames = np.asarray(frames)
    gaps = np.flatnonzero(np.diff(frames) > 1) + 1
    keep = np.zeros(len(frames), bool)
    keep[:: max(1, len(frames) // MOST_POINTS)] = True
    ends = np.concatenate([gaps, gaps - 1, [len(frames) - 1]]).astype(int) if len(frames) else np.zeros(0, int)
    keep[ends] = True
    # Where to insert, counted in the rows that are kept.
    breaks = np.searchsorted(np.flatnonzero(keep), gaps)
    return [np.insert(np.asarray(c, np.float64)[keep], breaks, np.nan, axis=0) for c in columns]


def legend_above(figure: Figure, ax: Axes, columns: int = 2) -> None:
    """Put the legend of ``ax`` above the axes, if anything in them has a label."""
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper left", ncols=columns, handlelength=1.8)
