"""What prgbd adds to Hydra: the options as structured configs, plug-ins without YAML, and YAML of other packages."""

from __future__ import annotations

import importlib
import importlib.util
import logging
from dataclasses import asdict
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin

from prgbd.cli.arguments import PLUGIN_GROUPS
from prgbd.cli.options import CommonOptions
from prgbd.cli.task_options import TASKS
from prgbd.core.option_schema import schema
from prgbd.core.registry import KINDS, REGISTRY, SHORT_FOR, PluginSpec

log = logging.getLogger(__name__)
CONF_GROUP = "prgbd.conf"
OWN_GROUPS = tuple(f"training.{kind}" for kind in SHORT_FOR)
"""Fields of the training's settings that are groups of their own: ``loss`` and ``augmentation``."""
OPEN_GROUPS = (*KINDS, "task", "trainer", "logger")
"""Nodes of the configuration whose options depend on what is chosen."""


class PluginPackagesSearchPath(SearchPathPlugin):
    """Adds the YAML folders that installed packages announce by the entry point group ``prgbd.conf``."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """See Hydra's ``SearchPathPlugin``."""
        for provider, folder in conf_folders():
            search_path.append(provider=provider, path=f"file://{folder}")


def conf_folders() -> list[tuple[str, Path]]:
    """Return (package, folder) of every installed package that brings YAML; none is imported."""
    found: list[tuple[str, Path]] = []
    for entry in metadata.entry_points(group=CONF_GROUP):
        # Finding a package imports those that it lies in, and that may do anything: only the outermost one is found.
        outermost, *within = entry.value.split(".")
        try:
            spec = importlib.util.find_spec(outermost)
        except (ImportError, ValueError) as error:
            log.warning("The YAML of %s (%s) could not be found: %s", entry.name, entry.value, error)
            continue
        places = list(spec.submodule_search_locations or ()) if spec is not None else []
        folders = [Path(place, *within) for place in places]
        found.extend((entry.name, folder) for folder in folders if folder.is_dir())
    return found


def register() -> None:
    """Tell Hydra the types and defaults of all options, the tasks and the plug-ins."""
    Plugins.instance().register(PluginPackagesSearchPath)
    store = ConfigStore.instance()
    store.store(name="options", node=schema(CommonOptions, OWN_GROUPS, **{group: {} for group in OPEN_GROUPS}))
    for name, options in TASKS.items():
        # Plain, for an experiment may set options of its task where the command line chooses another one.
        store.store(name=name, group="task", node={"name": name, **asdict(options())})
    _register_plugins(store)


def _register_plugins(store: ConfigStore) -> None:
    """Make every registered plug-in a choice of its Hydra group; one with YAML keeps its YAML.

    The options of a plug-in that names their dataclass are the choice ``KIND/options/ID``, for its YAML to start from.
    """
    folders = [Path(str(resources.files("prgbd.conf"))), *(folder for _, folder in conf_folders())]
    for kind in PLUGIN_GROUPS:
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
            node = {**default_options(REGISTRY.resolve(kind, plugin_id)), "id": plugin_id}
            store.store(name=name, node=node, group=group, package=kind)


def default_options(spec: PluginSpec) -> dict[str, Any]:
    """Return the options of a plug-in with their defaults, groups as mappings; {} if it names no dataclass."""
    options = options_class(spec)
    return {} if options is None else asdict(options())


def options_class(spec: PluginSpec) -> type[Any] | None:
    """Return the dataclass that a plug-in names for its options, None if it names none."""
    if not spec.options:
        return None
    module, _, name = spec.options.partition(":")
    found: type[Any] = getattr(importlib.import_module(module), name)
    return found
