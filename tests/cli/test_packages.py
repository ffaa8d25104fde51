"""Plug-ins and YAML of other packages, found by their entry points alone."""

import json
import sys
from pathlib import Path

import pytest


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A distribution on the path: two plug-ins without YAML, one with, and a broken one."""
    site = tmp_path / "site"
    info = site / "lab_plugins-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-plugins\nVersion: 1.2\nSummary: of a lab\n")
    (info / "entry_points.txt").write_text(
        "[prgbd.depth]\nlabnet = lab_plugins.nets:LabNet\nlab/net-v1 = lab_plugins.nets:LabNet\n"
        "lab/net-v2 = lab_plugins.nets:LabNet\nbroken = lab_plugins.broken:Net\n"
        "[prgbd.conf]\nlab = lab_plugins.conf\nmissing = lab_plugins.nowhere.conf\n"
    )
    home = site / "lab_plugins"
    (home / "conf" / "depth").mkdir(parents=True)
    (home / "__init__.py").write_text("")
    (home / "nets.py").write_text("from tests.loop.fakes import Tiny\n\n\nclass LabNet(Tiny):\n    pass\n")
    (home / "broken.py").write_text("import no_such_module_at_all\n")
    (home / "conf" / "depth" / "labnet_near.yaml").write_text("id: labnet\nstart: 1.5\n")
    monkeypatch.syspath_prepend(str(site))
    yield home
    for name in [n for n in sys.modules if n.startswith("lab_plugins")]:
        del sys.modules[name]


def start_depth(answer) -> float:
    assert answer.code == 0, answer.err
    return json.loads(Path("run/summary.json").read_text())["loops"][0]["depth_max"]["wall"]


@pytest.mark.parametrize("plugin_id", ["labnet", "lab/net-v1", "lab/net"])
def test_plugins_without_yaml_run_by_their_id(cli, package, plugin_id):
    answer = cli("slam=test/sideways", f"+depth={plugin_id}", "data=test/wall", "task=slam", "out=run")
    assert start_depth(answer) == pytest.approx(3.0, rel=0.15)


def test_their_options_are_known_by_the_plugin(cli, package):
    arguments = ("slam=test/sideways", "+depth=lab/net-v1", "data=test/wall", "task=slam", "out=run")
    refused = cli(*arguments, "depth.strat=2")
    assert refused.code == 2
    assert "'depth.start'" in refused.sentence
    assert start_depth(cli(*arguments, "depth.start=6")) == pytest.approx(6.0, rel=0.15)


def test_yaml_of_a_package_is_a_choice(cli, package):
    answer = cli("slam=test/sideways", "depth=labnet_near", "data=test/wall", "task=slam", "out=run")
    assert start_depth(answer) == pytest.approx(1.5, rel=0.15)


def test_a_broken_plugin_is_named_when_it_is_named_and_hurts_nobody_else(cli, package):
    answer = cli("slam=test/sideways", "depth=broken", "data=test/wall", "task=slam", "out=run")
    assert answer.code == 2
    for word in ("'broken'", "lab-plugins 1.2", "no_such_module_at_all"):
        assert word in answer.sentence
    assert "lab_plugins.nets" not in sys.modules
