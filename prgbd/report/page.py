"""``report.html``: one page about one run that needs no other file and no network."""

from __future__ import annotations

from html import escape
from pathlib import Path

from prgbd.io.files import atomic_path
from prgbd.report import depth_sections, interactive, sections
from prgbd.report.reading import Run, open_run, sum_pose
from prgbd.report.style import CSS
from prgbd.report.words import Change, depth_change, describe, held_out_change, number, percent, pose_change

LARGEST = 8_000_000  # bytes; a page beyond that is slow to open on a phone
TITLES = {
    "self_improve": "Self-improving SLAM and depth",
    "slam": "SLAM",
    "depth": "Depth prediction",
    "evaluate": "Evaluation",
    "pretrain": "Pre-training of the depth network",
}
# (width of a depth map in pixels, frames shown): the first that keeps the page small enough is taken.
DETAIL = ((560, 4), (400, 4), (320, 3), (240, 2), (160, 1), (80, 1))


def write_report(run: Path | str) -> Path:
    """Write ``report.html`` into a run folder, from whatever parts of the run are there.

    Args:
        run: The run folder (docs/summary-schema.md).

    Returns:
        The path of the page.

    Raises:
        DataError: If the folder has no readable ``summary.json``.
    """
    folder = open_run(run)
    html = render(folder)
    path = folder.path / "report.html"
    with atomic_path(path) as temporary:
        temporary.write_text(html, encoding="utf-8")
    return path


def render(run: Run) -> str:
    """Return the page of a run as HTML below ``LARGEST`` bytes."""
    before = sections.loops_section(run) + sections.pose_section(run)
    after = (
        depth_sections.depth_ranges_section(run)
        + sections.training_section(run)
        + sections.figures_section(run)
        + sections.setup_section(run)
    )
    for width, most in DETAIL:
        body = before + depth_sections.depth_section(run, width, most) + after
        if len(body.encode()) < LARGEST - 100_000:
            break
    title = TITLES.get(str(run.summary.get("task")), "Run")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)} · {escape(_subject(run))}</title><style>{CSS}</style>"
        f"{interactive.scripts()}</head><body>"
        f"{_header(run, title)}<main>{_cards(run)}{_problems(run)}{body}</main>{_footer(run)}</body></html>\n"
    )


def _subject(run: Run) -> str:
    names = run.sequences
    listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return f"{run.summary.get('data') or 'no data'} {listed}".strip()


def _header(run: Run, title: str) -> str:
    summary = run.summary
    facts = {
        "SLAM": summary.get("slam"),
        "depth": summary.get("depth"),
        "data": _subject(run),
        "seed": summary.get("seed"),
    }
    chips = "".join(
        f"<li><span>{escape(k)}</span>{escape(str(v))}</li>" for k, v in facts.items() if v not in (None, "")
    )
    first, *more = describe(summary)
    rest = "".join(f'<p class="more">{escape(sentence)}</p>' for sentence in more)
    return (
        f'<header><p class="eyebrow">prgbd run report</p><h1>{escape(title)}</h1><ul class="chips">{chips}</ul>'
        f'<p class="lead">{escape(first)}</p>{rest}</header>'
    )


def _cards(run: Run) -> str:
    cards = [
        _change_card("Pose error", pose_change(run.summary), len(run.kept_loops)),
        _change_card("Depth error", depth_change(run.summary), len(run.kept_loops)),
    ]
    if not any(cards):
        cards.append(_change_card("Held-out loss", held_out_change(run.summary), len(run.kept_loops)))
    if run.loops:
        last = run.kept_loops[-1]
        frames, tracked = sum_pose(last, "frames"), sum_pose(last, "tracked_frames")
        if frames:
            keyframes, points = sum_pose(last, "keyframes"), sum_pose(last, "points")
            parts = [f"{keyframes:,} keyframes" if keyframes else "", f"{points:,} map points" if points else ""]
            cards.append(
                _card(
                    "Frames with a pose",
                    f"{tracked or 0:,} <small>of {frames:,}</small>",
                    ", ".join(filter(None, parts)),
                )
            )
    seconds = run.summary.get("seconds")
    if seconds is not None:
        cards.append(
            _card("Time", _duration(float(seconds)), f"{len(run.loops)} SLAM passes" if len(run.loops) > 1 else "")
        )
    cards = [card for card in cards if card]
    return f'<div class="cards">{"".join(cards)}</div>' if cards else ""


def _change_card(name: str, change: Change | None, loops: int) -> str:
    if change is None:
        return ""
    value = f"{number(change.after)}{change.unit.replace(' ', '&nbsp;')}"
    if loops > 1:
        value = f"<small>{number(change.before)} →</small> {value}"
        value += f'<span class="badge {change.verdict}">{percent(change.relative)}</span>'
    return _card(name, value, change.basis)


def _card(name: str, value: str, basis: str) -> str:
    below = f'<div class="basis">{escape(basis)}</div>' if basis else ""
    return f'<div class="card"><div class="name">{escape(name)}</div><div class="value">{value}</div>{below}</div>'


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} <small>s</small>"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (
        f"{hours} <small>h</small> {minutes} <small>min</small>"
        if hours
        else f"{minutes} <small>min</small> {rest} <small>s</small>"
    )


def _problems(run: Run) -> str:
    if not run.problems:
        return ""
    lines = "".join(f"<p>{escape(text)}</p>" for text in dict.fromkeys(run.problems))
    return f'<div class="problems"><p><b>Not shown, because it could not be read:</b></p>{lines}</div>'


def _footer(run: Run) -> str:
    version = escape(str(run.summary.get("prgbd") or "?"))
    return (
        f"<footer>prgbd {version}. Method: Tiwari et al., Pseudo RGB-D for Self-Improving Monocular SLAM and Depth "
        "Prediction, ECCV 2020. Trajectory errors by evo.</footer>"
    )
