import sys

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import BrokenPluginError, ConfigError, ContractError, UnknownPluginError
from prgbd.core.registry import REGISTRY, PluginSpec, Registry, parse_id
from prgbd.plugins.__main__ import main as list_plugins


def spec(plugin_id: str, target: str = "tests.core.plugins:Constant", kind: str = "depth", **kwargs) -> PluginSpec:
    return PluginSpec(kind, plugin_id, target, kwargs=kwargs)


@pytest.fixture
def registry() -> Registry:
    return Registry()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("net", (None, "net", None)),
        ("net-v2", (None, "net", "2")),
        ("lab/net", ("lab", "net", None)),
        ("lab/my-net-v12", ("lab", "my-net", "12")),
        ("my-very-net", (None, "my-very-net", None)),
    ],
)
def test_ids_have_namespace_name_and_version(text, parts) -> None:
    assert tuple(parse_id(text).values()) == parts


@pytest.mark.parametrize("text", ["", "a/b/c", "9net", "net v1", "/net"])
def test_malformed_ids_are_refused(registry, text) -> None:
    with pytest.raises(ConfigError, match="no plug-in id"):
        registry.register(spec(text))


def test_an_id_without_version_means_the_newest(registry) -> None:
    for plugin_id in ("net-v2", "net-v10", "net-v9"):
        registry.register(spec(plugin_id))
    assert registry.resolve("depth", "net").id == "net-v10"
    assert registry.resolve("depth", "net-v2").id == "net-v2"
    with pytest.raises(UnknownPluginError, match="net-v"):
        registry.resolve("depth", "net-v3")


def test_registering_imports_nothing(registry) -> None:
    registry.register(spec("absent", "no_such_module:Thing"))
    assert "absent" in [s.id for s in registry.specs("depth")]
    assert "no_such_module" not in sys.modules


def test_a_broken_plugin_is_named_and_hurts_nobody_else(registry) -> None:
    registry.register(spec("absent", "no_such_module:Thing"))
    registry.register(spec("fine"))
    with pytest.raises(BrokenPluginError, match=r"'absent'.*no_such_module"):
        registry.make("depth", "absent")
    assert registry.make("depth", "fine") is not None


def test_an_unknown_id_answers_with_the_nearest() -> None:
    with pytest.raises(UnknownPluginError, match="'monodepth2'"):
        prgbd.make_depth("monodeph2")
    with pytest.raises(UnknownPluginError, match="orb_gtsam"):
        prgbd.make_slam("zzz")


def test_a_taken_id_is_refused_unless_overridden(registry) -> None:
    registry.register(spec("net"))
    with pytest.raises(ConfigError, match="taken"):
        registry.register(spec("net"))
    registry.register(spec("net", "tests.core.plugins:NotANumber"), override=True)
    assert registry.resolve("depth", "net").target.endswith("NotANumber")


def test_defaults_are_overridden_by_arguments(registry) -> None:
    registry.register(spec("net", value=3.0))
    assert registry.make("depth", "net").value == 3.0
    assert registry.make("depth", "net", value=4.0).value == 4.0


def test_an_unknown_option_answers_with_the_nearest(registry) -> None:
    registry.register(spec("net"))
    with pytest.raises(ConfigError, match=r"no option 'depth\.valu'; did you mean 'depth\.value'"):
        registry.make("depth", "net", valu=1.0)


def test_a_class_of_another_interface_is_refused(registry) -> None:
    registry.register(spec("net", "collections:OrderedDict"))
    with pytest.raises(ContractError, match=r"no subclass of prgbd\.DepthEstimator"):
        registry.make("depth", "net")


def test_an_error_in_the_constructor_is_named(registry) -> None:
    registry.register(spec("net", "tests.core.plugins:FailsToStart"))
    with pytest.raises(BrokenPluginError, match=r"'net'.*no licence"):
        registry.make("depth", "net")


@pytest.mark.parametrize("name", ["NotANumber", "Zero", "WrongShape", "NotAPrediction"])
def test_passive_checks_name_the_plugin(registry, name) -> None:
    import torch

    registry.register(spec("net", f"tests.core.plugins:{name}"))
    with pytest.raises(ContractError, match="'net'"):
        registry.make("depth", "net")(torch.rand(1, 3, 32, 64))
    registry.make("depth", "net", checks=False)(torch.rand(1, 3, 32, 64))


def test_every_built_in_imports_and_implements_its_interface() -> None:
    from prgbd.core.registry import KINDS, REGISTRY

    for kind in KINDS:
        for found in REGISTRY.specs(kind):
            if found.origin == "built-in":
                assert found.description
                if not found.missing:
                    assert REGISTRY.load(found)


def test_an_extra_that_is_not_installed_is_named_with_its_mend(registry) -> None:
    lacking = PluginSpec("depth", "net", "tests.core.plugins:Constant", extra="far", requires=("json", "no_such_thing"))
    registry.register(lacking)
    assert lacking.missing == ("no_such_thing",)
    with pytest.raises(BrokenPluginError, match=r"'net' needs no_such_thing; pip install 'prgbd\[far\]'"):
        registry.make("depth", "net")


def test_several_recordings_of_one_data_set(registry) -> None:
    registry.register(spec("clips", "tests.core.plugins:Clips", kind="data", frames=3))
    registry.register(spec("alone", "tests.core.plugins:Alone", kind="data"))
    assert [s.name for s in registry.make_sequences("clips")] == ["a", "b"]
    assert [s.name for s in registry.make_sequences("clips", ["b"], frames=2)] == ["b"]
    assert len(registry.make_sequences("alone")[0]) == 4
    with pytest.raises(ConfigError, match="No sequence"):
        registry.make_sequences("clips", [])
    with pytest.raises(ConfigError, match=r"did you mean 'data\.frames'"):
        registry.make_sequences("clips", frame=2)


def test_make_data_makes_one_recording() -> None:
    prgbd.register_data("test/clips", "tests.core.plugins:Clips", override=True)
    assert prgbd.make_data("test/clips", sequence="a").name == "a"
    assert prgbd.make_data("test/clips", sequences=["b"]).name == "b"
    with pytest.raises(ConfigError, match="make_sequences"):
        prgbd.make_data("test/clips", sequences=["a", "b"])


@pytest.mark.parametrize(
    ("option", "value", "wanted"),
    [
        ("fps", "abc", "a number"),
        ("fov", True, "a number"),
        ("start", "a", "a whole number"),
        ("step", 1.5, "a whole number"),
        ("stop", [3], "a whole number"),
    ],
)
def test_what_is_no_number_where_one_belongs_is_named_with_its_option(option, value, wanted) -> None:
    with pytest.raises(ConfigError, match=rf"^data=images: data\.{option} is .*; it must be {wanted}"):
        prgbd.make_data("images", root="anywhere", **{option: value})


def test_numbers_of_other_types_and_none_are_numbers(registry) -> None:
    registry.register(spec("net"))
    assert registry.make("depth", "net", value=np.float32(3)).value == 3
    assert registry.make("depth", "net", value=3).value == 3


def test_an_option_that_is_needed_is_named(registry) -> None:
    for make in (prgbd.make_data, prgbd.make_sequences):
        with pytest.raises(ConfigError, match=r"^data=images: The option data\.root has no default; add data\.root="):
            make("images", fov=60)


def test_plugins_of_packages_that_cannot_be_named_are_told(monkeypatch, tmp_path, capsys) -> None:
    info = tmp_path / "clash-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: clash\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[prgbd.depth]\nmonodepth2 = a:B\nno id! = a:B\nclash/fine = a:B\n")
    monkeypatch.syspath_prepend(tmp_path)
    told = REGISTRY.shadowed("depth")
    assert len(told) == 2
    assert "'monodepth2' of clash 1 has an id that is taken (built-in)" in told[0]
    assert "'no id!' of clash 1" in told[1]
    assert list_plugins(["depth"]) == 0
    assert told[0] in capsys.readouterr().out
