"""``report.html``: one page about one run that needs no other file and no network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from prgbd.io.files import atomic_path
from prgbd.report import curves, figures, pictures, tables
from prgbd.report.cards import cards
from prgbd.report.drawing import Drawing
from prgbd.report.reading import Run, first_and_last_samples, open_run
from prgbd.report.sequences import MOST_SEQUENCES, sequence_parts
from prgbd.report.templates import render as render_template
from prgbd.report.uncertainty import uncertainty_curves
from prgbd.report.words import describe

LARGEST = 8_000_000  # bytes; a page beyond that is slow to open on a phone
MOST_FILES = 400
TITLES = {
    "self_improve": "Self-improving SLAM and depth",
    "slam": "SLAM",
    "depth": "Depth prediction",
    "evaluate": "Evaluation",
    "pretrain": "Pre-training of the depth network",
}
# (width of a depth map in pixels, frames shown): the first that keeps the page small enough is taken.
DETAIL = ((560, 4), (400, 4), (320, 3), (240, 2), (160, 1), (80, 1))
# What can be compared by a slider, with one and with two predictions: name, picture on the left, picture on the right.
SLIDERS = {
    1: [("Image | depth", "image", "depth0")],
    2: [
        ("Depth before | after", "depth0", "depth1"),
        ("Error before | after", "error0", "error1"),
        ("Image | depth", "image", "depth1"),
        ("Truth | depth", "truth", "depth1"),
    ],
}


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
    parts = {
        "run": run,
        "title": TITLES.get(str(run.summary.get("task")), "Run"),
        "subject": _subject(run),
        "facts": _facts(run),
        "sentences": describe(run.summary),
        "cards": cards(run),
        "loops": tables.loops_table(run.summary),
        "panels": curves.loop_panels(run),
        "sequences": sequence_parts(run),
        "most_sequences": MOST_SEQUENCES,
        "ranges": curves.range_curves(run),
        "uncertainty": uncertainty_curves(run),
        "training": _training(run),
        "tables": [t for t in (tables.pose_table(run.summary), tables.depth_table(run.summary)) if not t.frame.empty],
        "versions": _versions(run),
        "configuration": run.text("config.yaml"),
        "files": _files(run),
    }
    samples = first_and_last_samples(run)
    for width, most in DETAIL:
        html = render_template("run.html", **parts, **_depth_maps(samples, width, most))
        if len(html.encode()) < LARGEST:
            break
    return html


def _subject(run: Run) -> str:
    names = run.sequences
    listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return f"{run.summary.get('data') or 'no data'} {listed}".strip()


def _facts(run: Run) -> dict[str, Any]:
    facts = {"SLAM": run.summary.get("slam"), "depth": run.summary.get("depth"), "data": _subject(run)}
    facts["seed"] = run.summary.get("seed")
    return {name: fact for name, fact in facts.items() if fact not in (None, "")}


def _depth_maps(samples: list[Any], width: int, most: int) -> dict[str, Any]:
    """Return depth maps before and after beside image and truth, as pictures no wider than ``width`` pixels."""
    frames = pictures.depth_rows(samples, most)
    largest = f"{pictures.ERROR_LIMIT:.0%}"
    return {
        "frames": frames,
        "with_truth": any(row.truth is not None for row in frames),
        "width": width,
        "pairs": SLIDERS[2 if len(samples) > 1 else 1],
        "scales": {"depth": pictures.DEPTH_MAP, "error": pictures.ERROR_MAP, "largest_error": largest},
    }


def _training(run: Run) -> list[Drawing]:
    """Return the loss curves of all loops."""
    found = [(run.label(loop), run.losses(loop)) for loop in run.loops]
    known = [(label, losses) for label, losses in found if losses]
    terms = figures.loss_terms(known)
    return [Drawing(f"training loss {term}", figures.loss_figure(known, term)) for term in terms]


def _versions(run: Run) -> dict[str, Any]:
    versions = {"prgbd": run.summary.get("prgbd"), "seed": run.summary.get("seed")}
    versions |= run.summary.get("versions") or {}
    return {name: version for name, version in versions.items() if version is not None}


def _files(run: Run) -> list[tuple[str, int]]:
    """Return name and size of the run's files but hidden ones and the page itself."""
    found = [(path, path.relative_to(run.path)) for path in sorted(run.path.rglob("*")) if path.is_file()]
    wanted = [(p, r) for p, r in found if not any(part.startswith(".") for part in r.parts) and r.name != "report.html"]
    return [(relative.as_posix(), path.stat().st_size) for path, relative in wanted[:MOST_FILES]]
