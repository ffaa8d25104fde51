"""The configuration that ships with prgbd."""

import subprocess
import sys
from dataclasses import asdict, fields
from importlib import resources
from pathlib import Path

import pytest
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from prgbd.cli.arguments import GROUPS, PLUGIN_GROUPS, normalise
from prgbd.cli.hydra_bridge import register
from prgbd.cli.hydra_errors import known_options
from prgbd.cli.options import read_options
from prgbd.cli.parts import names_of
from prgbd.cli.plugin_choices import LOOP_KEYS
from prgbd.cli.task_options import TASKS
from prgbd.core.registry import REGISTRY, PluginSpec
from prgbd.plugins.slam.orb_gtsam.settings import Settings, TrackingOptions
from prgbd.training.objective import METHOD, loss_weights
from prgbd.training.pretraining_settings import PretrainingSettings
from prgbd.training.refinement_settings import RefinementSettings

CONF = Path(str(resources.files("prgbd.conf")))


def composed(*arguments):
    register()
    with initialize_config_module("prgbd.conf", version_base="1.3"):
        return OmegaConf.to_container(compose("prgbd", overrides=normalise(arguments)), resolve=True)


@pytest.mark.parametrize("group", GROUPS)
def test_every_choice_of_every_group_composes(group):
    folder = CONF / group
    names = [
        str(path.relative_to(folder).with_suffix("")) for path in folder.rglob("*.yaml") if path.stem != "submitit"
    ]
    names = names or TASKS
    assert names
    for name in names:
        composed("slam=orb_gtsam", "depth=monodepth2", f"+{group}={name}")


@pytest.mark.parametrize("kind", PLUGIN_GROUPS)
def test_yaml_of_plugins_names_registered_ids(kind):
    for path in (CONF / kind).glob("*.yaml"):
        assert REGISTRY.resolve(kind, OmegaConf.load(path).id).id == path.stem


def test_refinement_defaults_are_said_in_full():
    config = composed()
    elsewhere = ("loss", "augmentation")
    assert config["training"] == {f.name: f.default for f in fields(RefinementSettings) if f.name not in elsewhere}
    assert loss_weights(config["loss"]) == RefinementSettings().weights
    assert tuple(RefinementSettings().weights.items()) == tuple(zip(METHOD, (1.0, 0.001, 1.0, 0.1), strict=True))
    for term, options in config["loss"].items():
        assert options == {n: p.default for n, p in REGISTRY.options("loss", term).items()}


def test_every_option_of_orb_gtsam_can_be_seen_with_its_default():
    node = composed("slam=orb_gtsam")["slam"]
    assert node == {"id": "orb_gtsam", **{key: node[key] for key in LOOP_KEYS["slam"]}, **asdict(Settings())}
    assert {"slam.tracking.local_keyframes", "slam.realtime", "slam.mode"} <= set(known_options())


def test_options_of_a_plugin_without_yaml_can_be_seen(monkeypatch):
    monkeypatch.setattr(REGISTRY, "_specs", dict(REGISTRY._specs))
    options = f"{Settings.__module__}:TrackingOptions"
    REGISTRY.register(PluginSpec("slam", "test/grouped", "nowhere:Nothing", options=options))
    assert composed("slam=test/grouped")["slam"] == {"id": "test/grouped", **asdict(TrackingOptions())}


def test_the_yaml_of_orb_gtsam_repeats_no_option():
    node = OmegaConf.load(CONF / "slam" / "orb_gtsam.yaml")
    assert set(node) == {"defaults", "id", *LOOP_KEYS["slam"]}


def test_pretraining_defaults_are_said_in_full():
    defaults = {f.name: f.default for f in fields(PretrainingSettings)}
    assert composed()["pretraining"] == defaults


@pytest.mark.parametrize(
    ("whole", "without"),
    [("all", f"no_{term}") for term in METHOD] + [("paper", f"paper_no_{t}") for t in METHOD if t != "smoothness"],
)
def test_each_ablation_switches_off_exactly_its_term(whole, without):
    term = without.partition("no_")[2]
    wanted = composed(f"loss={whole}")["loss"]
    wanted[term]["weight"] = 0
    assert composed(f"loss={without}")["loss"] == wanted


def test_a_number_stands_for_the_weight_of_a_term_and_keeps_its_other_options():
    loss = composed("experiment=paper", "slam=null", "loss.depth_transfer=0.2", "+loss.edge=0.1", "++loss.x.id=y")[
        "loss"
    ]
    assert loss["depth_transfer"]["weight"] == 0.2
    assert loss["depth_transfer"]["residual"] == "absolute"
    assert (loss["edge"], loss["x"]) == ({"weight": 0.1}, {"id": "y"})
    assert composed("augmentation.jitter=0.3")["augmentation"] == {"jitter": {"probability": 0.3}}


@pytest.mark.parametrize(
    ("typed", "names"),
    [
        ("[00,01]", ["00", "01"]),
        ("[09,10]", ["09", "10"]),
        ("00", ["00"]),
        ("['00']", ["00"]),
        ("[a,b-1]", ["a", "b-1"]),
    ],
)
def test_sequence_names_reach_the_data_plugin_as_they_were_typed(typed, names):
    assert names_of(read_options(composed(f"data.sequences={typed}")).data.sequences) == names


def test_known_options_are_those_of_the_configuration():
    names = known_options()
    wanted = {
        "seed",
        "training.learning_rate",
        "loss.photometric.weight",
        "task.max_loops",
        "task.png_scale",
        "slam",
        "task",
    }
    assert wanted <= set(names)
    assert not any(name.startswith("hydra") for name in names)


@pytest.mark.parametrize("kind", ["data", "depth"])
def test_yaml_of_plugins_gives_their_defaults(kind):
    """What the YAML says beside its choices is what the plug-in does without it."""
    for path in sorted((CONF / kind).glob("*.yaml")):
        node = OmegaConf.to_container(OmegaConf.load(path))
        plugin_id = node.pop("id")
        if REGISTRY.resolve(kind, plugin_id).missing:  # its extra is not installed
            continue
        options = REGISTRY.options(kind, plugin_id)
        for name, value in node.items():
            if name in LOOP_KEYS[kind] or value == "???" or "${" in str(value):  # a place in the run's folder
                continue
            assert name in options, f"{path}: {name}"
            if (path.stem, name) != ("monodepth2", "weights"):  # a loop that starts from scratch is of no use
                default = options[name].default
                assert (list(default) if isinstance(default, tuple) else default) == value, f"{path}: {name}"


def test_composing_imports_nothing_heavy():
    code = (
        "import sys; from prgbd.cli.hydra_bridge import register; register();"
        "print({'torch', 'lightning', 'cv2', 'gtsam', 'numba'} & set(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "set()"
