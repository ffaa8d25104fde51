"""Errors of Hydra and OmegaConf in one sentence."""

from __future__ import annotations

import difflib
import re
from importlib import resources
from pathlib import Path
from typing import Any

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException, ValidationError

from prgbd.cli.arguments import GROUPS, PLUGIN_GROUPS
from prgbd.cli.hydra_bridge import OWN_GROUPS, options_class
from prgbd.cli.options import CommonOptions
from prgbd.cli.task_options import TASKS
from prgbd.core.errors import ConfigError, PrgbdError
from prgbd.core.option_errors import listed, refused, unknown_option
from prgbd.core.options import option_types
from prgbd.core.registry import KINDS, REGISTRY, parse_id

MOVED = {
    "training.automask": "loss.photometric.automask",
    "training.patch": "loss.depth_transfer.patch",
    "training.matching": "loss.depth_transfer.matching",
    "training.reduction": "loss.depth_transfer.reduction",
    "training.anchored_transfer": "loss.depth_transfer.anchored",
    "training.residual": "loss.depth_consistency.residual and loss.depth_transfer.residual",
}
"""Options that were renamed: old -> new."""
FORMER_CHOICES = {
    "experiment/adapt": "its options are the defaults now: write slam=orb_gtsam depth=monodepth2 in its place",
    **{
        f"experiment/{name}": f"it is now experiment=paper/{name}"
        for name in ("ablation", "kitti_eigen", "kitti_odometry", "tum")
    },
}
"""Choices of groups that went, and what replaces them."""
INSTEAD = {
    "video": "data=video data.root=FILE",
    "images": "data=images data.root=FOLDER",
    "root": "data=video data.root=FILE, or data=images data.root=FOLDER",
}
"""What is written in place of options that newcomers guess."""


def explain(error: HydraException | OmegaConfBaseException | OSError) -> PrgbdError:
    """Turn an error of Hydra or OmegaConf into one sentence.

    Args:
        error: What Hydra raised while it put the configuration together.

    Returns:
        The error to raise in its place.
    """
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        return _unknown_choice(str(error.missing_cfg_file), list(error.options or ()))
    if isinstance(error, OverrideParseException):
        return _not_understood(error.override.lstrip("+"))
    text = str(error)
    cause = error.__cause__ or error.__context__ or error
    if isinstance(cause, ValidationError) and cause.full_key:
        return refused(cause.full_key, cause.value, _type_of(cause.full_key))
    several = re.search(r"Ambiguous value for argument '([^']+)'", text)
    if several:
        return ConfigError(f"'{several[1]}' names several values; add -m to run them all, or write a list: key=[a,b].")
    unresolved = re.search(r"Interpolation key '([^']+)' not found\s+full_key: (\S+)", text)
    if unresolved:
        return ConfigError(
            f"{unresolved[2]} refers to ${{{unresolved[1]}}}, which is no option; name another, or a value."
        )
    if missing := re.search(r"Could not delete from config. '([^']+)' does not exist", text):
        return unknown_option(missing[1], known_options())
    missing = re.search(r"Could not override '([^']+)'", text) or re.search(r"not in '\w+'\s+full_key: (\S+)", text)
    if missing and missing[1] in MOVED:
        return ConfigError(f"There is no option '{missing[1]}' any more; it is now {MOVED[missing[1]]}.")
    if missing and missing[1] in INSTEAD:
        return ConfigError(f"There is no option '{missing[1]}'; write {INSTEAD[missing[1]]}.")
    if missing and missing[1] in GROUPS:
        return ConfigError(f"{missing[1]}= takes one choice, such as {missing[1]}=ID; see --help.")
    if missing:
        return unknown_option(missing[1], known_options())
    return ConfigError(f"The configuration does not hold together: {' '.join(text.split())}; see --help.")


def _not_understood(override: str) -> ConfigError:
    key, _, value = override.partition("=")
    if any(quote in value for quote in "“”‘’"):
        mend = "it has curly quotes: write straight ones (\" or '), or none."
    elif re.search(r"\s\S+=", value):
        mend = "give every option=value as a word of its own, without quotes around all of them."
    elif value.rstrip().endswith((",", ";")):
        mend = f"leave out the '{value.rstrip()[-1]}' at its end."
    elif value.count("[") != value.count("]"):
        mend = "a list needs both brackets: option=[a,b]."
    else:
        mend = f"put values with special characters in quotes: \"{key}='value'\"."
    return ConfigError(f"'{override}' is not understood; {mend}")


def _type_of(key: str) -> Any:
    types = known_options()
    return types.get(key) or types.get(re.sub(r"(\[\d+\])+$", "", key), dict[str, Any])


def _unknown_choice(path: str, options: list[str]) -> PrgbdError:
    group, _, name = path.removesuffix(".yaml").partition("/")
    if (former := FORMER_CHOICES.get(f"{group}/{name}")) is not None:
        return ConfigError(f"There is no {group} '{name}' any more; {former}.")
    if group == "hydra":
        package = {"joblib": "'prgbd[joblib]'", "submitit_slurm": "hydra-submitit-launcher"}.get(name.split("/")[-1])
        mend = f"pip install {package}" if package else "see --hydra-help"
        return ConfigError(f"Hydra's {path} is not installed; {mend}.")
    if group == "data" and Path(name).expanduser().exists():
        kind = "images" if Path(name).expanduser().is_dir() else "video"
        return ConfigError(
            f"data= takes the kind of the recordings, and '{name}' is one; write data={kind} data.root={name}."
        )
    if group in PLUGIN_GROUPS:
        try:
            parse_id(name)
            REGISTRY.resolve(group, name)
        except PrgbdError as error:
            return error
    near = difflib.get_close_matches(name, options, n=3, cutoff=0.5)
    hint = f"did you mean {listed(near)}?" if near else f"there are {listed(sorted(options))}."
    return ConfigError(f"There is no {group} '{name}'; {hint}")


def known_options() -> dict[str, Any]:
    """Return the types of all options by their dotted names; Any for those of YAML files, and for the groups."""
    types = {key: kind for key, kind in option_types(CommonOptions).items() if key not in OWN_GROUPS}
    for task in TASKS.values():
        types |= option_types(task, "task")
    for spec in (spec for kind in KINDS for spec in REGISTRY.specs(kind)):
        if (options := options_class(spec)) is not None:
            types |= option_types(options, spec.kind)
    folder = Path(str(resources.files("prgbd.conf")))
    groups = [path.name for path in folder.iterdir() if path.is_dir() and not path.name.startswith("_")]
    for path in folder.glob("*/*.yaml"):
        if path.parent.name not in ("experiment", "executor"):
            node = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
            types |= dict.fromkeys(_dotted(node, path.parent.name), Any)
    return types | dict.fromkeys(("task", *groups), Any)


def _dotted(node: Any, prefix: str) -> list[str]:
    if not isinstance(node, dict):
        return [prefix]
    return [name for key, value in node.items() if key != "defaults" for name in _dotted(value, f"{prefix}.{key}")]
