"""What tells runs apart: the folders of runs, the options that differ between them, and names made of these."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from prgbd.io.reading import read_text

# Options that differ between runs without being what was varied.
NOT_VARIED = re.compile(r"^(hydra|run|out|output_dir|resume|progress|debug)(\.|$)")


def is_run(folder: Path) -> bool:
    """Return whether a folder holds a finished run."""
    return os.path.isfile(folder / "summary.json")


def find_runs(folder: Path | str) -> list[Path]:
    """Return the run folders at most three levels below ``folder``, in natural order (2 before 10).

    A folder with a ``config.yaml`` but no ``summary.json`` is a run that did not finish, and is returned as well.
    """
    folder = Path(folder)
    found = {
        p.parent
        for depth in ("*", "*/*", "*/*/*")
        for name in ("summary.json", "config.yaml")
        for p in folder.glob(f"{depth}/{name}")
        if not any(part.startswith(".") for part in p.relative_to(folder).parts)
    }
    outermost = [p for p in found if not any(parent in found for parent in p.parents)]
    return sorted(outermost, key=lambda p: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", str(p))])


def run_labels(paths: Sequence[Path]) -> list[str]:
    """Name each run by what differs: overrides, else choices of groups, else options, else the folders."""
    for read in (_overrides, _choices, configuration):
        options = varied([read(path) for path in paths])
        labels = [", ".join(f"{k}={v}" for k, v in row.dropna().items()) for _, row in options.iterrows()]
        if all(labels) and len(set(labels)) == len(labels):
            return labels
    return [path.name for path in paths]


def varied(options: Sequence[dict[str, str]]) -> pd.DataFrame:
    """Return the options that differ, a row for each run and a column for each option; NaN where a run has none."""
    frame = pd.DataFrame(list(options), dtype=object)
    return frame[[k for k in frame if frame[k].nunique(dropna=False) > 1 and not NOT_VARIED.search(k)]]


def _overrides(path: Path) -> dict[str, str]:
    """Return the overrides that were noted for a job, as Hydra does."""
    items = _yaml(path / ".hydra" / "overrides.yaml")
    if not isinstance(items, list):
        return {}
    pairs = [str(item).lstrip("+~").split("=", 1) for item in items]
    return {pair[0]: pair[1] for pair in pairs if len(pair) == 2}


def _choices(path: Path) -> dict[str, str]:
    """Return what was chosen from each group, which a run notes in its configuration."""
    config = _yaml(path / "config.yaml")
    notes = config.get("run") if isinstance(config, dict) else None
    choices = notes.get("choices") if isinstance(notes, dict) else None
    return {str(k): str(v) for k, v in choices.items()} if isinstance(choices, dict) else {}


def configuration(path: Path) -> dict[str, str]:
    """Return all options of a run, ``a.b`` -> text; empty where its ``config.yaml`` cannot be read."""
    config = _yaml(path / "config.yaml")
    flat = pd.json_normalize(config).to_dict("records") if isinstance(config, dict) else []
    return {str(key): str(value) for key, value in flat[0].items()} if flat else {}


def _yaml(path: Path) -> Any:
    from omegaconf import OmegaConf

    try:
        return OmegaConf.to_container(OmegaConf.create(read_text(path, "the options of a run")), resolve=False)
    except Exception:  # a label is no reason to lose a table, and the YAML parsers have many exceptions
        return None
