"""``resume=FOLDER``: which run to go on with, and whether the rest of the command fits it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from prgbd.cli import job
from prgbd.cli.arguments import GROUPS, is_multirun, is_true
from prgbd.core.errors import ConfigError
from prgbd.loop.store import newest_unfinished, read_config

HARMLESS = ("debug", "progress", "viz")
OUTPUTS = Path("outputs")


def resume(value: str, arguments: Sequence[str]) -> None:
    """Go on with a run.

    Args:
        value: The folder, or ``last`` or ``true`` for the newest unfinished run under ``outputs``.
        arguments: All (normalised) arguments. Those that the run was started with may be repeated, harmless ones may
            change.

    Raises:
        ConfigError: If there is no such run, or an argument contradicts it.
    """
    if is_multirun(arguments):
        raise ConfigError("The runs of a multirun are resumed one by one; drop -m, and resume=FOLDER_OF_A_RUN.")
    folder = newest_unfinished(OUTPUTS) if value.lower() == "last" or is_true(value) else Path(value.strip("'\""))
    config = read_config(folder)
    job.check_saved(config, folder)
    job.resume(folder, _changes(config, arguments, folder))


def _changes(config: dict[str, Any], arguments: Sequence[str], folder: Path) -> dict[str, Any]:
    started_with = set(config.get(job.META, {}).get("overrides", ()))
    changes = {}
    for argument in arguments:
        key, _, text = argument.lstrip("+").partition("=")
        if key == "resume" or argument.startswith("-"):
            continue
        value = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))["value"]  # type: ignore[index, call-overload]
        if key in HARMLESS:
            changes[key] = value
        elif argument not in started_with and not _agrees(config, key, value):
            raise ConfigError(
                f"The run in {folder} goes on with the configuration it was started with, which '{argument}' "
                "contradicts; leave it out, or start a new run without resume."
            )
    return changes


def _agrees(config: dict[str, Any], key: str, value: Any) -> bool:
    """Say whether the option has that value in the run already."""
    if key in GROUPS:
        return bool(config.get(job.META, {}).get("choices", {}).get(key) == value)
    node: Any = config
    for part in key.split("."):
        if not isinstance(node, dict) or part not in node:
            return False
        node = node[part]
    return bool(node == value)
