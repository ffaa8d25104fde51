"""Plug-ins as a Python caller gives them: by id, by id with options, or as objects and what makes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Sequence as Many
from functools import partial
from typing import Any

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import ConfigError
from prgbd.core.registry import REGISTRY
from prgbd.core.slam import GeometricSLAM
from prgbd.core.wrappers import wrap

Named = str | tuple[str, Mapping[str, Any]]
"""The id of a plug-in, or the id with its options."""
GivenDepth = DepthEstimator | Callable[[], DepthEstimator] | Named
GivenSlam = Callable[[], GeometricSLAM] | Named
GivenData = Sequence | Named | Many[Sequence | Named]

Description = dict[str, Any]
"""``id`` and options, as in the configuration of a run; the name of the class for an object."""


def make_network(given: GivenDepth) -> tuple[DepthEstimator, Description]:
    """Return a depth network and its description.

    ``wrappers`` among the options of an id are put around the network, as ``depth.wrappers`` on the command line.

    Raises:
        ConfigError: If it is nothing of the kind.
        PrgbdError: What the plug-in complains about.
    """
    named = _named(given)
    if named is not None:
        plugin_id, options = named
        wrappers = options.pop("wrappers", None) or []
        return wrap(REGISTRY.make("depth", plugin_id, **options), wrappers), _described(given)
    estimator = given if isinstance(given, DepthEstimator) else _called(given, "depth")
    if not isinstance(estimator, DepthEstimator):
        raise ConfigError(f"depth is {given!r}; give a prgbd.DepthEstimator, what makes one, or the id of a plug-in.")
    return estimator, {"id": type(estimator).__name__}


def slam_maker(given: GivenSlam) -> tuple[Callable[[], GeometricSLAM], Description]:
    """Return what makes a SLAM system, tried once, and its description.

    Raises:
        ConfigError: If it is nothing of the kind.
        PrgbdError: What the plug-in complains about.
    """
    named = _named(given)
    make = (
        partial(REGISTRY.make, "slam", named[0], **named[1]) if named is not None else partial(_called, given, "slam")
    )
    system = make()
    if not isinstance(system, GeometricSLAM):
        raise ConfigError(f"slam is {given!r}; give a subclass of prgbd.GeometricSLAM, what makes one, or an id.")
    system.close()
    return make, _described(given) if named is not None else {"id": type(system).__name__}


def make_recordings(given: GivenData) -> tuple[list[Sequence], Description]:
    """Return recordings and their description.

    ``sequences`` among the options of an id names those to make, as ``data.sequences`` on the command line.

    Raises:
        ConfigError: If something is nothing of the kind.
        PrgbdError: What the plug-in complains about.
    """
    if isinstance(given, Sequence):
        return [given], {"id": type(given).__name__, "sequences": [given.name]}
    named = _named(given)
    if named is not None:
        plugin_id, options = named
        names = options.pop("sequences", None)
        names = [names] if isinstance(names, str) else names
        return REGISTRY.make_sequences(plugin_id, names, **options), _described(given)
    if not isinstance(given, list | tuple):
        raise ConfigError(f"data holds {given!r}; give recordings (prgbd.Sequence), or ids of plug-ins.")
    several = [make_recordings(one) for one in given]
    sequences = [sequence for found, _ in several for sequence in found]
    ids = dict.fromkeys(description["id"] for _, description in several)
    return sequences, {"id": ", ".join(ids), "sequences": [sequence.name for sequence in sequences]}


def _named(given: Any) -> tuple[str, dict[str, Any]] | None:
    """Return id and options where a plug-in is named so."""
    if isinstance(given, str):
        return given, {}
    if isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], str) and isinstance(given[1], Mapping):
        return given[0], dict(given[1])
    return None


def _described(given: Any) -> Description:
    plugin_id, options = _named(given) or ("", {})
    return {"id": plugin_id, **options}


def _called(given: Any, kind: str) -> Any:
    """Call what makes a plug-in."""
    if isinstance(given, GeometricSLAM):
        raise ConfigError(
            f"slam is a {type(given).__name__} that is made already, but every run needs one of its own; give the "
            "class, or a function that makes it."
        )
    return given() if callable(given) else given
