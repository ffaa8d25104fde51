"""The sections of the page: each takes a run and returns HTML, or nothing where the run has nothing to show."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import SlamResult
from prgbd.report import figures, interactive, tables
from prgbd.report.aligned import aligned_sequence, entry_colours
from prgbd.report.drawing import figure_html, inline_svg, to_svg
from prgbd.report.figures import Path3D, Timeline
from prgbd.report.interactive import Cloud
from prgbd.report.reading import Run, mean_pose

MOST_SEQUENCES = 12


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
    drawn, colours = aligned_sequence(run, name, results), entry_colours(run)
    lines = [_timeline(run.label(loop), result, colours[id(loop)]) for loop, result in results]
    caption = (
        "State of every frame; white ticks are keyframes, ▲ loop closures, ● frames found again after tracking was "
        "lost. Below, the matches that agree with each frame's pose."
    )
    right = figure_html(figures.timeline_figure(lines), f"tracking of {name}", caption, key + "k")
    if drawn.errors:
        caption = "Distance from the true position after Sim3 alignment, by frame; a gap is where there is no pose."
        right += figure_html(figures.error_figure(drawn.errors), f"position errors of {name}", caption, key + "e")
    if not drawn.paths:
        return f'<div class="grid">{right}</div>'
    points = drawn.clouds[-1].xyz if drawn.clouds else None
    caption = _path_caption(drawn.has_truth, drawn.left_out)
    left = trajectories_html(name, drawn.paths, drawn.clouds[-2:], points, drawn.axes, drawn.unit, caption, key)
    return f'<div class="grid"><div>{left}</div><div>{right}</div></div>'


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
    svg = inline_svg(to_svg(drawing), f"trajectories of {name} from above", key + "t")
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
