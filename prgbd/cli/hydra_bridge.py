"""What prgbd adds to Hydra: plug-ins without YAML, YAML of other packages, and errors in one sentence."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import logging
import re
from dataclasses import asdict
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from prgbd.core.errors import ConfigError, PrgbdError
from prgbd.core.options import listed, unknown_option
from prgbd.core.registry import KINDS, REGISTRY, PluginSpec, parse_id

log = logging.getLogger(__name__)
CONF_GROUP = "prgbd.conf"


class PluginPackagesSearchPath(SearchPathPlugin):
    """Adds the YAML folders that installed packages announce by the entry point group ``prgbd.conf``."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """See Hydra's ``SearchPathPlugin``."""
        for provider, folder in conf_folders():
            search_path.append(provider=provider, path=f"file://{folder}")


def conf_folders() -> list[tuple[str, Path]]:
    """Return (package, folder) of every installed package that brings YAML; a broken package is left out."""
    found: list[tuple[str, Path]] = []
    for entry in metadata.entry_points(group=CONF_GROUP):
        try:
            spec = importlib.util.find_spec(entry.value)
        except Exception as error:  # a broken package may raise anything, and must not hurt the others
            log.warning("The YAML of %s (%s) could not be found: %s", entry.name, entry.value, error)
            continue
        places = list(spec.submodule_search_locations or ()) if spec is not None else []
        found.extend((entry.name, Path(place)) for place in places if Path(place).is_dir())
    return found


def register_plugins() -> None:
    """Make every registered plug-in a choice of its Hydra group; one with YAML keeps its YAML.

    The options of a plug-in that names their dataclass are the choice ``KIND/options/ID``, for its YAML to start from.
    """
    Plugins.instance().register(PluginPackagesSearchPath)
    folders = [Path(str(resources.files("prgbd.conf"))), *(folder for _, folder in conf_folders())]
    store = ConfigStore.instance()
    for kind in KINDS:
        specs = REGISTRY.specs(kind)
        for spec in specs:
            if spec.options:
                store.store(name=spec.id, node=default_options(spec), group=f"{kind}/options", package=kind)
        ids = {name for spec in specs for name in (spec.id, spec.versionless)}
        for plugin_id in sorted(ids):
            if any((folder / kind / f"{plugin_id}.yaml").is_file() for folder in folders):
                continue
            namespace, _, name = plugin_id.rpartition("/")
            group = f"{kind}/{namespace}" if namespace else kind
            options = default_options(REGISTRY.resolve(kind, plugin_id))
            store.store(name=name, node={**options, "id": plugin_id}, group=group, package=kind)


def default_options(spec: PluginSpec) -> dict[str, Any]:
    """Return the options of a plug-in with their defaults, groups as mappings; {} if it names no dataclass."""
    if not spec.options:
        return {}
    module, _, name = spec.options.partition(":")
    return asdict(getattr(importlib.import_module(module), name)())


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
        return ConfigError(
            f"'{error.override.lstrip('+')}' is not understood; write option=value, and put values with special "
            "characters in quotes: \"option='value'\"."
        )
    text = str(error)
    several = re.search(r"Ambiguous value for argument '([^']+)'", text)
    if several:
        return ConfigError(f"'{several[1]}' names several values; add -m to run them all, or write a list: key=[a,b].")
    missing_key = re.search(r"Could not override '([^']+)'", text)
    if missing_key:
        return unknown_option(missing_key[1], known_options())
    return ConfigError(f"The configuration does not hold together: {' '.join(text.split())}; see --help.")


def _unknown_choice(path: str, options: list[str]) -> PrgbdError:
    group, _, name = path.removesuffix(".yaml").partition("/")
    if group == "hydra":
        package = {"joblib": "'prgbd[joblib]'", "submitit_slurm": "hydra-submitit-launcher"}.get(name.split("/")[-1])
        mend = f"pip install {package}" if package else "see --hydra-help"
        return ConfigError(f"Hydra's {path} is not installed; {mend}.")
    if group in KINDS:
        try:
            parse_id(name)
            REGISTRY.resolve(group, name)
        except PrgbdError as error:
            return error
    near = difflib.get_close_matches(name, options, n=3, cutoff=0.5)
    hint = f"did you mean {listed(near)}?" if near else f"there are {listed(sorted(options))}."
    return ConfigError(f"There is no {group} '{name}'; {hint}")


def known_options() -> list[str]:
    """Return the dotted names of all options of the built-in configuration, and the names of the groups."""
    folder = Path(str(resources.files("prgbd.conf")))
    names: set[str] = set()
    for path in folder.rglob("*.yaml"):
        if path.parent.name in ("experiment", "executor", "hydra"):
            continue
        node = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
        prefix = "" if path.parent == folder else path.parent.name
        if isinstance(node, dict):
            names.update(_dotted(node, prefix))
    for spec in (spec for kind in KINDS for spec in REGISTRY.specs(kind)):
        names.update(_dotted(default_options(spec), spec.kind))
    names.update(p.name for p in folder.iterdir() if p.is_dir() and not p.name.startswith("_"))
    return sorted(n for n in names if not n.startswith(("hydra", "defaults")))


def _dotted(node: dict, prefix: str) -> list[str]:
    names = []
    for key, value in node.items():
        name = f"{prefix}.{key}" if prefix else str(key)
        names.extend(_dotted(value, name) if isinstance(value, dict) else [name])
    return names
