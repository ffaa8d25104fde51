"""What a refinement is asked to do: the loss terms and augmentations that a configuration names.

Both are given as nodes, name -> options. A name is the id of a plug-in (its namespace may be left out where that is
clear), or anything where the node says ``id``. A plain number stands for the weight of a term, or for the probability
of an augmentation. What stands here once serves every plug-in: nothing below knows a term by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from prgbd.core.errors import ConfigError
from prgbd.core.option_errors import shown
from prgbd.core.option_ranges import NotNegative, Share
from prgbd.core.options import converted
from prgbd.core.registry import REGISTRY, SHORT_FOR

if TYPE_CHECKING:
    from prgbd.core.augmentation import Augmentation
    from prgbd.core.loss import LossTerm

Nodes = Mapping[str, Mapping[str, Any] | float]

METHOD: Nodes = {name: {} for name in ("photometric", "smoothness", "depth_consistency", "depth_transfer")}
"""The four terms of the method with their own weights."""
RANGES = {"loss": NotNegative, "augmentation": Share}
"""What the option that a plain number stands for may be."""
STANDARD: Nodes = {name: {} for name in ("mirror", "jitter")}
"""The augmentations of ``training.augment=true``, as Monodepth2 has them."""


def read_nodes(kind: str, nodes: Nodes) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return name -> (id of the plug-in, its options), checked without making anything.

    Raises:
        ConfigError: If a node is neither a mapping nor a number, or a plug-in has no such option.
        UnknownPluginError: If there is no such plug-in.
    """
    if not isinstance(nodes, Mapping):
        raise ConfigError(f"{kind} is {shown(nodes)}; give options such as {kind}.ID.{SHORT_FOR[kind]}=0.5.")
    found = {}
    for name, node in nodes.items():
        if isinstance(node, int | float) and not isinstance(node, bool):
            node = {SHORT_FOR[kind]: node}
        if not isinstance(node, Mapping):
            raise ConfigError(
                f"{kind}.{name} is {shown(node)}; give options such as {kind}.{name}.{SHORT_FOR[kind]}=0.5, "
                "or that number."
            )
        options = {str(key): value for key, value in node.items()}
        wanted = converted(options.pop("id", str(name)), str, f"{kind}.{name}.id")
        plugin_id = REGISTRY.find(kind, wanted).id
        checked = REGISTRY.checked_options(kind, plugin_id, options, f"{kind}.{name}")
        if (short := SHORT_FOR[kind]) in checked:  # plug-ins of others may declare no range
            converted(checked[short], RANGES[kind], f"{kind}.{name}.{short}")
        found[str(name)] = (plugin_id, checked)
    return found


def loss_weights(nodes: Nodes) -> dict[str, float]:
    """Return the weight of every loss term by its name, without making any.

    Raises:
        ConfigError: If a weight cannot work, or all of them are 0.
    """
    weights = {}
    for name, (plugin_id, options) in read_nodes("loss", nodes).items():
        weight = options.get("weight", REGISTRY.options("loss", plugin_id)["weight"].default)
        weights[name] = float(weight)
    if not any(weights.values()):
        raise ConfigError("All loss weights are 0, so nothing would be trained; set one of loss.* above 0.")
    return weights


def make_terms(nodes: Nodes) -> dict[str, LossTerm]:
    """Make the loss terms that have a weight, by their names."""
    weights = loss_weights(nodes)
    return {
        name: REGISTRY.make("loss", plugin_id, **options)
        for name, (plugin_id, options) in read_nodes("loss", nodes).items()
        if weights[name]
    }


def make_augmentations(nodes: Nodes, standard: bool = False) -> list[Augmentation]:
    """Make the augmentations that change anything, in order.

    Args:
        nodes: Those that were named, with their options.
        standard: Whether ``STANDARD`` comes first, with the options of its nodes.
    """
    named = read_nodes("augmentation", nodes)
    wanted = {**(read_nodes("augmentation", STANDARD) if standard else {}), **named}
    made: list[Augmentation] = [
        REGISTRY.make("augmentation", plugin_id, **options) for plugin_id, options in wanted.values()
    ]
    return [augmentation for augmentation in made if augmentation.probability > 0]
