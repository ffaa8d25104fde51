"""Plug-ins of other packages that raise, or end the program, wherever prgbd calls them: one sentence names them."""

from __future__ import annotations

import sys
import uuid
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from prgbd import LossTerm
from prgbd.__main__ import main
from prgbd.core.registry import REGISTRY, PluginSpec
from tests.loop import fakes
from tests.loop.fakes import Sideways, Tiny, Wall
from tests.robustness.fuzzing import examples, judged_exit

EXITS = ((SystemExit, 0), (SystemExit,), (SystemExit, "bye"))
FAULTS = (*EXITS, (RuntimeError, "no paper"), (KeyError, 3), (AssertionError,))
PLACES = (
    *(("depth", name) for name in ("__init__", "forward", "predict", "preprocess", "save_weights", "load_weights")),
    *(("slam", name) for name in ("__init__", "reset", "track", "finish", "close")),
    *(("data", name) for name in ("__init__", "available", "frame", "depth", "__len__")),
    *(("loss", name) for name in ("__init__", "forward")),
)


class Zero(LossTerm):
    """A term that says nothing."""

    def forward(self, inputs):
        return inputs.current.depth.sum() * 0


SOUND = {"depth": Tiny, "slam": Sideways, "data": Wall, "loss": Zero}
COMMAND = ("+slam=test/sideways", "+depth=test/tiny", "data=test/wall", "task.max_loops=1", "out=run")


def misbehaving(kind: str, place: str, fault: tuple[Any, ...]) -> type:
    """Return a class like the sound one whose method ``place`` raises."""

    def raises(*args, **kwargs):
        raise fault[0](*fault[1:])

    method = classmethod(raises) if place == "available" else raises
    return type("Broken", (SOUND[kind],), {place: method, "__module__": __name__})


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    fakes.register()
    return tmp_path_factory.mktemp("runs")


@examples(small=3, large=80)
@given(place=st.sampled_from(PLACES), fault=st.sampled_from(FAULTS), number=st.integers(0, 10**9))
def test_faults_of_plugins(here: Path, place: tuple[str, str], fault: tuple[Any, ...], number: int) -> None:
    kind, method = place
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        patch.setattr("prgbd.report.page.write_report", lambda run: None)
        patch.setitem(globals(), "Broken", misbehaving(kind, method, fault))
        spec = PluginSpec(kind, "test/broken", f"{__name__}:Broken")
        patch.setitem(REGISTRY._specs, (kind, "test/broken"), spec)
        chosen = "loss.test/broken.weight=1" if kind == "loss" else f"{'' if kind == 'data' else '+'}{kind}=test/broken"
        written: list[str] = []
        patch.setattr(sys.stderr, "write", lambda text: written.append(text) or len(text))
        code = main([*COMMAND, chosen, f"out=run-{uuid.uuid4().hex}", f"seed={number % 7}"])
    output = "".join(written)
    judged_exit(f"plug-ins that raise in {kind}", code, output)
    # What a run of these small parts never calls may be broken without anybody noticing.
    assert code == 2 or method in ("load_weights", "predict", "preprocess", "close", "__len__", "depth"), (code, output)
    assert code == 0 or "test/broken" in output


def test_a_package_of_yaml_is_found_without_being_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib import metadata

    from prgbd.cli.hydra_bridge import conf_folders

    folder = tmp_path / "exits_lab" / "conf"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").write_text("raise SystemExit(0)")
    (folder / "__init__.py").write_text("raise SystemExit(0)")
    monkeypatch.syspath_prepend(tmp_path)
    entry = metadata.EntryPoint("exits", "exits_lab.conf", "prgbd.conf")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [entry])
    assert conf_folders() == [("exits", folder)]
