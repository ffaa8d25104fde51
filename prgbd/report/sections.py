"""The sections of the page: each takes a run and returns HTML, or nothing where the run has nothing to show."""

from __future__ import annotations

import base64
import json
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.alignment import Alignment, fit_alignment
from prgbd.core.export import match_times
from prgbd.core.types import SlamResult, Trajectory
from prgbd.report import figures, interactive, pictures, range_figures, tables
from prgbd.report.figures import Path3D, Timeline
from prgbd.report.interactive import Cloud
from prgbd.report.reading import Run, mean_pose
from prgbd.report.words import number

MOST_SEQUENCES = 12
FEWEST_POSES = 3


def figure_html(figure: Any, label: str, caption: str, key: str) -> str:
    """Return a figure element; ``key`` must be unique on the page, ``caption`` is HTML."""
    svg = figures.inline_svg(figures.to_svg(figure), label, key)
    return f"<figure>{svg}{f'<figcaption>{caption}</figcaption>' if caption else ''}</figure>"


def loops_section(run: Run) -> str:
    """Return the table of loops and the figures over the loops."""
    table = tables.loops_table(run.summary)
    if not table.rows:
        return ""
    html = "<h2>Loops</h2>" + tables.to_html(table, caption=False)
    if len(run.loops) > 1:
        panels = _panels(run)
        drawn = [
            figure_html(figures.metric_figure(title, series), f"{title} by loop", "", f"m{i}-")
            for i, (title, series) in enumerate(panels)
        ]
        html += f'<div class="grid small">{"".join(drawn)}</div>' if drawn else ""
    return html


def _panels(run: Run) -> list[tuple[str, dict[str, list[float | None]]]]:
    panels: list[tuple[str, dict[str, list[float | None]]]] = []
    names = run.sequences[:8]
    pose = {n: [mean_pose(loop, "ate_rmse", [n]) for loop in run.loops] for n in names}
    pose = {n: values for n, values in pose.items() if any(v is not None for v in values)}
    if pose:
        panels.append(("ATE RMSE (m)", pose))
    for key, title in (("abs_rel", "Abs Rel"), ("rmse", "depth RMSE (m)"), ("a1", "δ<1.25")):
        values = [(loop.get("depth") or {}).get(key) for loop in run.loops]
        if any(v is not None for v in values):
            panels.append((title, {key: values}))
    return panels


def pose_section(run: Run) -> str:
    """Return trajectories over truth, errors over time and the tracking of every sequence."""
    html = ""
    for number_, name in enumerate(run.sequences[:MOST_SEQUENCES]):
        found = [(loop, run.result(loop, name)) for loop in run.entries]
        results = [(loop, result) for loop, result in found if result is not None]
        if results:
            html += f"<h3>{escape(name)}</h3>" + _sequence(run, name, results, f"s{number_}-")
    if not html:
        return ""
    if len(run.sequences) > MOST_SEQUENCES:
        html += f'<p class="note">The first {MOST_SEQUENCES} of {len(run.sequences)} sequences are drawn.</p>'
    return "<h2>Trajectories and tracking</h2>" + html


def _sequence(run: Run, name: str, results: list[tuple[dict[str, Any], SlamResult]], key: str) -> str:
    colours = _colours(run)
    truth = run.truth(name)
    reference = truth if truth is not None and len(truth) >= FEWEST_POSES else results[0][1].trajectory
    paths = [Path3D("truth", np.arange(len(truth)), truth.positions)] if truth is not None and len(truth) else []
    series, points, left_out = [], None, []
    clouds: list[Cloud] = []
    for loop, result in results:
        aligned = align(result.trajectory, reference)
        label, colour = run.label(loop), colours[id(loop)]
        if aligned is None:
            left_out.append(label)
            continue
        transform, rows, errors = aligned
        ate = ((loop.get("pose") or {}).get(name) or {}).get("ate_rmse")
        suffix = f", {number(ate)} m" if ate is not None else ""
        paths.append(
            Path3D(label + suffix, result.trajectory.frame_index, transform.points(result.trajectory.positions), colour)
        )
        if len(result.points):
            points = transform.points(result.points.xyz)
            clouds.append(Cloud(label + suffix, points, result.points.rgb))
        if reference is truth:
            series.append((label, colour, result.trajectory.frame_index[rows], errors))
    left, right = "", ""
    if paths:
        axes, unit = figures.horizontal_axes(reference.wTc), "m" if reference is truth else "map units"
        left = trajectories_html(
            name, paths, clouds[-2:], points, axes, unit, _path_caption(truth is not None, left_out), key
        )
    lines = [_timeline(run.label(loop), r, colours[id(loop)]) for loop, r in results]
    caption = (
        "State of every frame; white ticks are keyframes, ▲ loop closures, ● frames found again after tracking was "
        "lost. Below, the matches that agree with each frame's pose."
    )
    right = figure_html(figures.timeline_figure(lines), f"tracking of {name}", caption, key + "k")
    if series:
        caption = "Distance from the true position after Sim3 alignment, by frame; a gap is where there is no pose."
        right += figure_html(figures.error_figure(series), f"position errors of {name}", caption, key + "e")
    return (
        f'<div class="grid"><div>{left}</div><div>{right}</div></div>' if left else f'<div class="grid">{right}</div>'
    )


def _colours(run: Run) -> dict[int, str]:
    baselines = run.entries[: len(run.entries) - len(run.loops)]
    found = dict(zip(map(id, baselines), figures.BASELINE_COLOURS, strict=False))
    return found | dict(zip(map(id, run.loops), figures.loop_colours(len(run.loops)), strict=True))


def trajectories_html(
    name: str,
    paths: list[Path3D],
    clouds: list[Cloud],
    points: NDArray[np.float64] | None,
    axes: tuple[int, int],
    unit: str,
    caption: str,
    key: str,
) -> str:
    """Return the drawing that can be turned, and the one from above for paper and for browsers without scripts.

    Args:
        name: Of the sequence.
        paths: The paths, the truth first.
        clouds: Maps in the drawing that can be turned.
        points: (P, 3) map points below the drawing from above, or None.
        axes: World axes to the right and up, see ``figures.horizontal_axes``.
        unit: Unit of lengths.
        caption: HTML below.
        key: Prefix of ids, unique on the page.
    """
    drawing = figures.trajectory_figure(paths, axes, points, unit)
    svg = figures.inline_svg(figures.to_svg(drawing), f"trajectories of {name} from above", key + "t")
    view = interactive.view_html(paths, clouds, axes, unit, f"interactive trajectories and map of {name}")
    return f'<figure>{view}<div class="static">{svg}</div><figcaption>{caption}</figcaption></figure>'


def _timeline(label: str, result: SlamResult, colour: str) -> Timeline:
    states = list(result.states)
    found = [i for i in range(1, len(states)) if states[i] == "ok" and states[i - 1] == "lost"]
    notes = result.stats.get("loops") if isinstance(result.stats, dict) else None
    closures = [int(note["frame"]) for note in notes or [] if isinstance(note, dict) and "frame" in note]
    return Timeline(label, states, result.inliers, result.keyframes.frame_index, colour, closures, found)


def _path_caption(with_truth: bool, left_out: list[str]) -> str:
    if with_truth:
        text = "Seen from above, Sim3-aligned to the truth. The figure beside each name is its ATE RMSE."
    else:
        text = "Seen from above. There is no ground truth, so later loops are Sim3-aligned to the first."
    return f"{text} Dots: the last loop's map." + (
        f" Too few poses to draw: {escape(', '.join(left_out))}." if left_out else ""
    )


def align(
    estimate: Trajectory, reference: Trajectory
) -> tuple[Alignment, NDArray[np.int64], NDArray[np.float64]] | None:
    """Return the Sim3 alignment to the reference, the rows it rests on and their distances; None if too few."""
    rows, others = match_times(estimate.timestamp, reference.timestamp, 0.02)
    if len(rows) < FEWEST_POSES:
        return None
    x, y = estimate.positions[rows], reference.positions[others]
    transform = fit_alignment(x, y, "sim3")
    return transform, rows, np.linalg.norm(transform.points(x) - y, axis=1)


def depth_section(run: Run, width: int, most: int) -> str:
    """Return depth maps before and after beside image and truth, as pictures no wider than ``width`` pixels."""
    found = [(run.label(loop), run.samples(loop)) for loop in run.kept_loops]
    known = [(label, samples) for label, samples in found if samples is not None and len(samples.keys)]
    chosen = known if len(known) < 2 else [known[0], known[-1]]
    rows = pictures.depth_rows(chosen, most)
    if not rows:
        return ""
    html = "<h2>Depth</h2>"
    scaled = (
        "to the truth" if any(row.truth is not None for row in rows) else "to the first prediction (there is no truth)"
    )
    lede = f"Predictions are median-scaled {scaled}; each frame has one colour scale for all its depth maps."
    html += f'<p class="lede">{lede}</p>'
    return html + "".join(_frame(row, width) for row in rows)


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
    known = [(run.label(loop), loop["depth"]) for loop in run.loops if (loop.get("depth") or {}).get("images")]
    chosen = known if len(known) < 2 else [known[0], known[-1]]
    colours = figures.loop_colours(len(chosen))
    drawn = []
    for i, (metric, title) in enumerate((("abs_rel", "Abs Rel"), ("rmse", "RMSE (m)"), ("a1", "δ<1.25"))):
        curves = [
            (label, colour, [row["cap"] for row in depth["by_cap"]], [row.get(metric) for row in depth["by_cap"]])
            for (label, depth), colour in zip(chosen, colours, strict=True)
            if depth.get("by_cap")
        ]
        if curves:
            figure = range_figures.cap_figure(f"{title} by cap", curves)
            drawn.append(figure_html(figure, f"{title} by depth cap", "", f"c{i}-"))
    for i, (metric, title) in enumerate((("abs_rel", "Abs Rel"), ("rmse", "RMSE (m)"))):
        bins = [
            (label, colour, depth["by_depth"])
            for (label, depth), colour in zip(chosen, colours, strict=True)
            if depth.get("by_depth")
        ]
        if bins:
            figure = range_figures.bin_figure(f"{title} by distance", bins, metric)
            drawn.append(figure_html(figure, f"{title} by true depth", "", f"b{i}-"))
    drawn += _by_loop_and_cap(run)
    if not drawn:
        return ""
    lede = (
        "By cap: the whole protocol with the truth cut off at that depth, means over images. By distance: all pixels "
        "whose true depth lies in that range, after the scaling of the headline cap. By loop: the first of these, with "
        "one line per cap."
    )
    return f'<h3>Depth by range</h3><p class="lede">{lede}</p><div class="grid medium">{"".join(drawn)}</div>'


def _by_loop_and_cap(run: Run) -> list[str]:
    """Return the curves of the paper's second figure: metrics over the loops, one line per cap."""
    found = [(loop.get("depth") or {}).get("by_cap") or [] for loop in run.loops]
    caps = list(dict.fromkeys(row["cap"] for rows in found for row in rows))
    drawn = []
    for i, (metric, title) in enumerate((("abs_rel", "Abs Rel"), ("sq_rel", "Sq Rel (m)"), ("rmse", "RMSE (m)"))):
        curves = {
            f"{cap:g} m": [next((row.get(metric) for row in rows if row["cap"] == cap), None) for rows in found]
            for cap in caps
        }
        if len(found) > 1 and caps:
            figure = figures.metric_figure(f"{title} by loop and cap", curves)
            drawn.append(figure_html(figure, f"{title} by loop, a line per depth cap", "", f"lc{i}-"))
    return drawn


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


def training_section(run: Run) -> str:
    """Return the loss curves of all loops."""
    found = [(run.label(loop), run.losses(loop)) for loop in run.loops]
    known = [(label, losses) for label, losses in found if losses]
    drawn = [
        figure_html(figures.loss_figure(known, term), f"training loss {term}", "", f"l{i}-")
        for i, term in enumerate(figures.loss_terms(known))
    ]
    if not drawn:
        return ""
    lede = "Loss by term, step by step (thin) and smoothed. A dotted line is where the next loop begins."
    return f'<h2>Training</h2><p class="lede">{lede}</p><div class="grid medium">{"".join(drawn)}</div>'


def figures_section(run: Run) -> str:
    """Return the full tables of pose and depth figures."""
    parts = [tables.to_html(t) for t in (tables.pose_table(run.summary), tables.depth_table(run.summary)) if t.rows]
    return "<h2>All figures</h2>" + "".join(parts) if parts else ""


def setup_section(run: Run) -> str:
    """Return configuration, versions and files."""
    summary = run.summary
    facts = {"prgbd": summary.get("prgbd"), "seed": summary.get("seed"), **(summary.get("versions") or {})}
    rows = "".join(f"<dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd>" for k, v in facts.items() if v is not None)
    html = f"<h2>Set-up and files</h2><details><summary>Versions</summary><dl class=facts>{rows}</dl></details>"
    config = run.text("config.yaml")
    if config:
        html += f"<details><summary>Configuration</summary><pre>{escape(config)}</pre></details>"
    wanted = [
        p for p in sorted(run.path.rglob("*")) if p.is_file() and not p.name.startswith(".") and p.name != "report.html"
    ]
    relative = [p.relative_to(run.path) for p in wanted]
    shown = [
        (p, r) for p, r in zip(wanted, relative, strict=True) if not any(part.startswith(".") for part in r.parts)
    ][:400]
    items = "".join(
        f'<li><a href="{escape(r.as_posix(), quote=True)}">{escape(r.as_posix())}</a> {_size(p.stat().st_size)}</li>'
        for p, r in shown
    )
    return html + (f"<details><summary>Files</summary><ul class=files>{items}</ul></details>" if items else "")


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{max(1, round(size / 1e3))} kB"
