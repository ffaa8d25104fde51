"""``python -m prgbd.plugins``: the list, and ``check``."""

from __future__ import annotations

import pytest

from prgbd import register_depth
from prgbd.core.registry import REGISTRY, PluginSpec
from prgbd.plugins.__main__ import main
from tests.loop import fakes


@pytest.fixture(autouse=True)
def plugins(monkeypatch):
    """Some good and bad plug-ins that are gone after the test."""
    monkeypatch.setattr(REGISTRY, "_specs", dict(REGISTRY._specs))
    fakes.register()
    for name, cls in (("nan", "NotANumber"), ("shape", "WrongShape"), ("constant", "Constant"), ("raises", "Raises")):
        register_depth(f"bad/{name}", f"tests.core.plugins:{cls}")
    register_depth("bad/import", "no_such_module_at_all:Net", "cannot be imported")
    lacking = PluginSpec("depth", "far", "tests.core.plugins:Constant", "a", extra="x", requires=("no_such_thing",))
    REGISTRY.register(lacking)


def test_the_list_says_what_an_extra_would_bring(capsys) -> None:
    assert main(["depth"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "built-in" in next(line for line in lines if line.startswith("monodepth2"))
    assert "pip install 'prgbd[x]'" in next(line for line in lines if line.startswith("far"))
    assert any(line.startswith("bad/import") for line in lines)  # a broken one is listed, for nothing is imported


def test_a_sound_plugin_passes_with_a_line_per_check(capsys) -> None:
    assert main(["check", "bad/constant"]) == 0
    out = capsys.readouterr().out
    assert out.count("  ok ") == 5
    assert "All 5 checks passed." in out


def test_slam_and_data_are_checked_too(capsys) -> None:
    assert main(["check", "synthetic", "sequence=indoor-1", "frames=3", "width=64", "height=48"]) == 0
    assert main(["check", "slam:test/sideways"]) in (0, 1)
    assert "mode" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("plugin_id", "words"),
    [
        ("bad/nan", ("NotANumber", "NaN")),
        ("bad/shape", ("WrongShape", "must be (2, 1, H, W)")),
        ("bad/raises", ("raised ZeroDivisionError: division by zero",)),
    ],
)
def test_what_fails_is_said_in_a_sentence_and_the_rest_is_still_checked(capsys, plugin_id, words) -> None:
    assert main(["check", plugin_id]) == 1
    out = capsys.readouterr().out
    assert "FAILS" in out
    assert "  ok    declares" in out
    for word in words:
        assert word in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("bad/import",), ("'bad/import'", "no_such_module_at_all")),
        (("far",), ("needs no_such_thing", "prgbd[x]")),
        (("monodpeth2",), ("did you mean 'monodepth2'",)),
        (("nothing_like_it",), ("There is no plug-in 'nothing_like_it'",)),
        (("bad/constant", "valu=3"), ("no option 'depth.valu'", "'depth.value'")),
        (("bad/constant", "3"), ("write option=value",)),
        (("kitti_odometry", "root=no_such_folder"), ("no_such_folder",)),
    ],
)
def test_what_cannot_be_checked_is_answered_in_one_sentence(capsys, arguments, words) -> None:
    assert main(["check", *arguments]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    for word in words:
        assert word in error
