"""The registry: ids to lazily imported classes, for built-ins and third-party packages alike.

A plug-in is an id (``name`` or ``namespace/name``, optional ``-vN``), a ``module:Class`` that is imported only when
the plug-in is made, default keyword arguments and a one-line description. Packages bring plug-ins through entry point
groups, ``prgbd.depth`` and so on, one per kind (name = id, value = ``module:Class``).
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import TYPE_CHECKING, Any

from prgbd.core.errors import BrokenPluginError, ConfigError, ContractError, PrgbdError, UnknownPluginError
from prgbd.core.option_errors import listed
from prgbd.core.options import checked_arguments, keyword_parameters

if TYPE_CHECKING:
    from prgbd.core.augmentation import Augmentation
    from prgbd.core.criterion import Criterion
    from prgbd.core.data import Sequence
    from prgbd.core.depth import DepthEstimator
    from prgbd.core.loss import LossTerm
    from prgbd.core.slam import GeometricSLAM

INTERFACES = {
    "depth": "prgbd.core.depth:DepthEstimator",
    "slam": "prgbd.core.slam:GeometricSLAM",
    "data": "prgbd.core.data:Sequence",
    "loss": "prgbd.core.loss:LossTerm",
    "criterion": "prgbd.core.criterion:Criterion",
    "augmentation": "prgbd.core.augmentation:Augmentation",
}
KINDS = tuple(INTERFACES)
SHORT_FOR = {"loss": "weight", "augmentation": "probability"}
"""Kinds of which a run uses several at once, and the option that a plain number stands for: ``loss.edge=0.1``."""
ID_PATTERN = re.compile(r"^(?:(?P<namespace>[\w.-]+)/)?(?P<name>[A-Za-z_][\w.-]*?)(?:-v(?P<version>\d+))?$")


@dataclass(frozen=True)
class PluginSpec:
    """What is known of a plug-in before it is imported.

    Attributes:
        kind: One of ``KINDS``.
        id: The full id, ``[namespace/]name[-vN]``.
        target: ``module:Class``.
        description: One line for listings.
        origin: Where it comes from: ``built-in``, ``registered in code`` or a distribution with its version.
        kwargs: Default keyword arguments of the class.
        extra: The optional dependencies that it needs, as ``pip install 'prgbd[extra]'`` names them; "" for none.
        requires: The modules that the extra brings.
        options: ``module:Dataclass`` of the options, "" where the constructor's signature tells them. The command line
            shows its defaults, so its module must import nothing heavy.
    """

    kind: str
    id: str
    target: str
    description: str = ""
    origin: str = "registered in code"
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    extra: str = ""
    requires: tuple[str, ...] = ()
    options: str = ""

    @property
    def missing(self) -> tuple[str, ...]:
        """The modules of ``requires`` that are not installed; none is imported."""
        return tuple(name for name in self.requires if importlib.util.find_spec(name) is None)

    @property
    def versionless(self) -> str:
        """The id without its version."""
        return self.id.rsplit("-v", 1)[0] if self.version is not None else self.id

    @property
    def version(self) -> int | None:
        """The version number, or None."""
        found = parse_id(self.id)["version"]
        return None if found is None else int(found)


def parse_id(plugin_id: str) -> dict[str, str | None]:
    """Split an id into ``namespace``, ``name`` and ``version``.

    Raises:
        ConfigError: If the text is not an id.
    """
    found = ID_PATTERN.match(plugin_id)
    if found is None:
        raise ConfigError(f"'{plugin_id}' is no plug-in id; write [namespace/]name[-vN], for example 'lab/mynet-v1'.")
    return found.groupdict()


class Registry:
    """All plug-ins of all kinds. One instance, ``prgbd.core.registry.REGISTRY``, serves the process."""

    def __init__(self) -> None:
        self._specs: dict[tuple[str, str], PluginSpec] = {}

    def register(self, spec: PluginSpec, *, override: bool = False) -> None:
        """Add a plug-in; nothing is imported.

        Raises:
            ConfigError: If the kind, id or target is malformed, or the id is taken and ``override`` is False.
        """
        _check_kind(spec.kind)
        parse_id(spec.id)
        if not re.fullmatch(r"[\w.]+:[\w.]+", spec.target):
            raise ConfigError(f"The target '{spec.target}' of the plug-in '{spec.id}' must be written 'module:Class'.")
        if (spec.kind, spec.id) in self._specs and not override:
            raise ConfigError(
                f"The {spec.kind} plug-in id '{spec.id}' is taken already; choose another id or pass override=True."
            )
        self._specs[(spec.kind, spec.id)] = spec

    def specs(self, kind: str) -> list[PluginSpec]:
        """Return every plug-in of a kind, registered ones first, then those of installed packages."""
        _check_kind(kind)
        found = {spec_id: spec for (k, spec_id), spec in self._specs.items() if k == kind}
        for entry in metadata.entry_points(group=f"prgbd.{kind}"):
            origin = _origin(entry)
            target = entry.value.partition("[")[0].strip()  # what an extra of the package is written in
            spec = PluginSpec(kind, entry.name, target, _summary(entry), origin)
            if ID_PATTERN.match(entry.name):
                found.setdefault(entry.name, spec)
        return list(found.values())

    def shadowed(self, kind: str) -> list[str]:
        """Return a sentence for each plug-in of an installed package that cannot be named, with the reason."""
        known = {spec.id: spec for spec in self.specs(kind)}
        found = []
        for entry in metadata.entry_points(group=f"prgbd.{kind}"):
            origin = _origin(entry)
            if not ID_PATTERN.match(entry.name):
                found.append(f"The {kind} plug-in '{entry.name}' of {origin} has a name that is no id; rename it.")
            elif known[entry.name].origin != origin:
                by = known[entry.name].origin
                found.append(
                    f"The {kind} plug-in '{entry.name}' of {origin} has an id that is taken ({by}); rename it."
                )
        return found

    def resolve(self, kind: str, plugin_id: str) -> PluginSpec:
        """Find a plug-in by id; an id without version means the newest version.

        Raises:
            UnknownPluginError: With the nearest ids.
        """
        specs = {spec.id: spec for spec in self.specs(kind)}
        if plugin_id in specs:
            return specs[plugin_id]
        versions = [s for s in specs.values() if s.version is not None and s.versionless == plugin_id]
        if versions:
            return max(versions, key=lambda s: s.version or 0)
        near = difflib.get_close_matches(plugin_id.lower(), list(specs), n=3, cutoff=0.5)
        near += [s for s in specs if s not in near and parse_id(s)["name"] == plugin_id.rsplit("/", 1)[-1]]
        hint = f"did you mean {listed(near)}?" if near else f"there are {listed(sorted(specs))}."
        raise UnknownPluginError(f"There is no {kind} plug-in '{plugin_id}'; {hint}")

    def find(self, kind: str, name: str) -> PluginSpec:
        """Find a plug-in by its id, or by the name behind its namespace where a single namespace has it.

        Raises:
            UnknownPluginError: With the nearest ids.
        """
        try:
            return self.resolve(kind, name)
        except UnknownPluginError:
            same = {spec.versionless for spec in self.specs(kind) if parse_id(spec.id)["name"] == name}
            if len(same) != 1:
                raise
            return self.resolve(kind, same.pop())

    def load(self, spec: PluginSpec) -> type[Any]:
        """Import the class of a plug-in.

        Raises:
            BrokenPluginError: If the import fails; the message names the plug-in and the package it comes from, or
                the extra that is not installed.
            ContractError: If the class does not implement the interface of its kind.
        """
        if spec.missing:
            raise BrokenPluginError(
                f"The {spec.kind} plug-in '{spec.id}' needs {' and '.join(spec.missing)}; "
                f"pip install 'prgbd[{spec.extra}]'."
            )
        try:
            target = _import(spec.target)
        except (Exception, SystemExit) as error:  # a module that calls sys.exit must not end the program
            raise BrokenPluginError(
                f"The {spec.kind} plug-in '{spec.id}' ({spec.origin}) could not be imported from {spec.target}: "
                f"{type(error).__name__}: {error}; mend or uninstall it."
            ) from error
        interface = _import(INTERFACES[spec.kind])
        if not (inspect.isclass(target) and issubclass(target, interface)):
            raise ContractError(
                f"The {spec.kind} plug-in '{spec.id}' ({spec.origin}) is no subclass of prgbd.{interface.__name__}; "
                f"derive {spec.target} from it."
            )
        return target

    def options(self, kind: str, plugin_id: str) -> dict[str, inspect.Parameter]:
        """Return the constructor's keyword options of a plug-in (imports it)."""
        return keyword_parameters(self.load(self.resolve(kind, plugin_id)))

    def checked_options(self, kind: str, plugin_id: str, given: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
        """Return the options of a plug-in with the types that its constructor has, without making it (imports it).

        Args:
            kind: Its kind.
            plugin_id: Its id.
            given: Plain values by name.
            prefix: Where they stand on the command line; the kind if "".

        Raises:
            UnknownPluginError: If the id is not registered.
            BrokenPluginError: If importing it fails.
            ConfigError: If it has no such option, or the option does not take the value.
        """
        spec = self.resolve(kind, plugin_id)
        if not isinstance(given, Mapping):
            raise ConfigError(f"{prefix or kind} is {given!r}; it must be a group of options.")
        return checked_arguments(self.load(spec), {**spec.kwargs, **given}, prefix or kind)

    def make(self, kind: str, plugin_id: str, *, checks: bool = True, **kwargs: Any) -> Any:
        """Make a plug-in, with the passive checks around it unless ``checks`` is False.

        Raises:
            UnknownPluginError: If the id is not registered.
            BrokenPluginError: If importing or constructing it fails.
            ConfigError: If it has no option of a given name, or one of another type.
        """
        from prgbd.core.testing.passive import with_checks  # brings numpy, which listing plug-ins does not need

        spec = self.resolve(kind, plugin_id)
        cls = self.load(spec)
        arguments = _checked(spec, cls, {**spec.kwargs, **kwargs})
        try:
            plugin = cls(**arguments)
        except PrgbdError:
            raise
        except (Exception, SystemExit) as error:
            raise BrokenPluginError(
                f"The {kind} plug-in '{spec.id}' ({spec.origin}) could not be made: {type(error).__name__}: {error}; "
                "check its options or mend it."
            ) from error
        return with_checks(kind, spec.id, plugin) if checks else plugin

    def make_sequences(
        self, plugin_id: str, sequences: list[str] | None = None, *, checks: bool = True, **kwargs: Any
    ) -> list[Sequence]:
        """Make several recordings of one data set; all that are available when ``sequences`` is None.

        Raises:
            DataError: If the data set or a named recording is absent.
        """
        if sequences is None:
            spec = self.resolve("data", plugin_id)
            cls = self.load(spec)
            names = _available(spec, cls, _checked(spec, cls, {**spec.kwargs, **kwargs}))
        else:
            names = list(sequences)
        if not names:
            raise ConfigError(f"No sequence of '{plugin_id}' was chosen; name at least one in data.sequences.")
        chosen = [kwargs if name is None else {**kwargs, "sequence": name} for name in names]
        return [self.make("data", plugin_id, checks=checks, **options) for options in chosen]


REGISTRY = Registry()


def register_depth(
    plugin_id: str, target: str, description: str = "", *, override: bool = False, **kwargs: Any
) -> None:
    """Register a depth estimator: an id, a lazy ``module:Class`` and default keyword arguments."""
    REGISTRY.register(PluginSpec("depth", plugin_id, target, description, kwargs=kwargs), override=override)


def register_slam(plugin_id: str, target: str, description: str = "", *, override: bool = False, **kwargs: Any) -> None:
    """Register a SLAM system: an id, a lazy ``module:Class`` and default keyword arguments."""
    REGISTRY.register(PluginSpec("slam", plugin_id, target, description, kwargs=kwargs), override=override)


def register_data(plugin_id: str, target: str, description: str = "", *, override: bool = False, **kwargs: Any) -> None:
    """Register a data set: an id, a lazy ``module:Class`` and default keyword arguments."""
    REGISTRY.register(PluginSpec("data", plugin_id, target, description, kwargs=kwargs), override=override)


def register_loss(plugin_id: str, target: str, description: str = "", *, override: bool = False, **kwargs: Any) -> None:
    """Register a loss term: an id, a lazy ``module:Class`` and default keyword arguments."""
    REGISTRY.register(PluginSpec("loss", plugin_id, target, description, kwargs=kwargs), override=override)


def register_criterion(
    plugin_id: str, target: str, description: str = "", *, override: bool = False, **kwargs: Any
) -> None:
    """Register a criterion: an id, a lazy ``module:Class`` and default keyword arguments."""
    REGISTRY.register(PluginSpec("criterion", plugin_id, target, description, kwargs=kwargs), override=override)


def register_augmentation(
    plugin_id: str, target: str, description: str = "", *, override: bool = False, **kwargs: Any
) -> None:
    """Register an augmentation: an id, a lazy ``module:Class`` and default keyword arguments."""
    REGISTRY.register(PluginSpec("augmentation", plugin_id, target, description, kwargs=kwargs), override=override)


def make_depth(plugin_id: str, **kwargs: Any) -> DepthEstimator:
    """Make a depth estimator by id, e.g. ``make_depth("monodepth2", weights="folder")``."""
    made: DepthEstimator = REGISTRY.make("depth", plugin_id, **kwargs)
    return made


def make_slam(plugin_id: str, **kwargs: Any) -> GeometricSLAM:
    """Make a SLAM system by id, e.g. ``make_slam("orb_gtsam", features={"count": 2000})``."""
    made: GeometricSLAM = REGISTRY.make("slam", plugin_id, **kwargs)
    return made


def make_data(plugin_id: str, *, sequences: list[str] | None = None, **kwargs: Any) -> Sequence:
    """Make one recording by id, e.g. ``make_data("kitti_odometry", root="kitti", sequence="00")``.

    ``sequences`` with one name is accepted in place of ``sequence``; for several use ``make_sequences``.

    Raises:
        ConfigError: If ``sequences`` names several recordings.
    """
    if sequences is not None:
        if len(sequences) != 1:
            raise ConfigError("make_data makes one recording; use make_sequences for several.")
        kwargs["sequence"] = sequences[0]
    made: Sequence = REGISTRY.make("data", plugin_id, **kwargs)
    return made


def make_sequences(plugin_id: str, sequences: list[str] | None = None, **kwargs: Any) -> list[Sequence]:
    """Make several recordings of one data set by id; all that are available when ``sequences`` is None."""
    return REGISTRY.make_sequences(plugin_id, sequences, **kwargs)


def make_loss(plugin_id: str, **kwargs: Any) -> LossTerm:
    """Make a loss term by id, e.g. ``make_loss("photometric", weight=0.5)``."""
    made: LossTerm = REGISTRY.make("loss", plugin_id, **kwargs)
    return made


def make_criterion(plugin_id: str, **kwargs: Any) -> Criterion:
    """Make a criterion by id, e.g. ``make_criterion("slam")``."""
    made: Criterion = REGISTRY.make("criterion", plugin_id, **kwargs)
    return made


def make_augmentation(plugin_id: str, **kwargs: Any) -> Augmentation:
    """Make an augmentation by id, e.g. ``make_augmentation("jitter", strength=0.5)``."""
    made: Augmentation = REGISTRY.make("augmentation", plugin_id, **kwargs)
    return made


def specs(kind: str) -> list[PluginSpec]:
    """Return every plug-in of a kind without importing any."""
    return REGISTRY.specs(kind)


def _check_kind(kind: str) -> None:
    if kind not in KINDS:
        raise ConfigError(f"'{kind}' is no kind of plug-in; the kinds are {listed(list(KINDS))}.")


def _import(target: str) -> Any:
    module, _, name = target.partition(":")
    found: Any = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found


def _checked(spec: PluginSpec, cls: type[Any], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments with the types that the class wants; the message for others names the plug-in."""
    try:
        return checked_arguments(cls, arguments, spec.kind)
    except ConfigError as error:
        raise ConfigError(f"{spec.kind}={spec.id}: {error}") from None


def _available(spec: PluginSpec, cls: type[Sequence], options: Mapping[str, Any]) -> list[Any]:
    """Ask a data set for the names of its recordings."""
    try:
        names = cls.available(**options)
    except PrgbdError:
        raise
    except (Exception, SystemExit) as error:
        raise BrokenPluginError(
            f"The data plug-in '{spec.id}' ({spec.origin}) could not list its recordings: {type(error).__name__}: "
            f"{error}; check its options or mend it."
        ) from error
    if not isinstance(names, list | tuple) or not all(name is None or isinstance(name, str) for name in names):
        raise ContractError(
            f"The data plug-in '{spec.id}' ({spec.origin}) answers a {type(names).__name__} in available; it must be a "
            "list of names."
        )
    return list(names)


def _origin(entry: metadata.EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "entry point"


def _summary(entry: metadata.EntryPoint) -> str:
    """The one line that a package says of itself: an entry point carries no description of its own."""
    return str(entry.dist.metadata["Summary"] or "") if entry.dist else ""
