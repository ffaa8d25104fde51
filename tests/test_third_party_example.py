"""``examples/third_party_plugin``: built, installed into a fresh environment, checked, and run by its ids."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PLUGINS = ("+slam=example/rgbd_vo", "+depth=example/unet", "experiment=example_tiny")


@pytest.fixture(scope="module")
def python(tmp_path_factory) -> Path:
    """The interpreter of a new environment that sees this one's packages and has the example's wheel installed."""
    folder = tmp_path_factory.mktemp("example")
    source = shutil.copytree(ROOT / "examples" / "third_party_plugin", folder / "source")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    offline = ("--no-deps", "--no-index", "--no-build-isolation")
    subprocess.run([*pip, "wheel", *offline, "-w", folder / "dist", source], check=True, timeout=300)
    wheel = next((folder / "dist").glob("prgbd_example-*.whl"))

    venv.create(folder / "env", with_pip=False)
    scripts = "Scripts" if os.name == "nt" else "bin"
    interpreter = folder / "env" / scripts / "python"
    site = subprocess.check_output([interpreter, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"])
    packages = sysconfig.get_path("purelib")
    (Path(site.decode().strip()) / "of_the_tests.pth").write_text(f"import site; site.addsitedir({packages!r})\n")
    subprocess.run([*pip, "--python", interpreter, "install", *offline, wheel], check=True, timeout=300)
    return interpreter


@pytest.fixture
def call(python, tmp_path):
    """Run a module in the new environment, in an empty folder."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.run(
            [python, "-m", *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=500
        )

    return run


def test_this_environment_does_not_have_it(python) -> None:
    program = "import importlib.util as u; raise SystemExit(u.find_spec('prgbd_example') is None)"
    assert subprocess.run([python, "-c", program]).returncode == 0
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT / "tests").returncode == 1


def test_its_own_tests_pass(call, python) -> None:
    ran = call(
        "pytest", "-q", "-p", "no:cacheprovider", "-n", "0", str(ROOT / "examples" / "third_party_plugin" / "tests")
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout.startswith("......."), ran.stdout


def test_all_are_listed_and_checked(call) -> None:
    listing = call("prgbd.plugins")
    assert listing.returncode == 0, listing.stderr
    for name in ("unet", "rgbd_vo", "wall", "edge", "tracked", "dark"):
        plugin_id = f"example/{name}"
        line = next(line for line in listing.stdout.splitlines() if line.startswith(plugin_id))
        assert "prgbd-example 0.1.0" in line
    checked = call("prgbd.plugins", "check", "example/edge")
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_the_loop_runs_both_by_their_ids_and_their_yaml(call, tmp_path) -> None:
    ran = call("prgbd", *PLUGINS, "depth.channels=8", "out=run")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["slam"], summary["depth"]) == ("example/rgbd_vo", "example/unet")
    assert len(summary["loops"]) == 2
    assert (tmp_path / "run" / "report.html").is_file()


def test_its_depth_network_is_pretrained_by_its_own_pose_network(call, tmp_path) -> None:
    options = ("task=pretrain", "pretraining.max_steps=2", "pretraining.batch_size=2", "depth.channels=8")
    ran = call("prgbd", *PLUGINS, *options, "data.frames=8", "out=run")
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_a_sweep_over_the_weight_of_its_loss_gives_a_row_each(call, tmp_path) -> None:
    """Every kind of plug-in of the package takes part, by command line alone."""
    options = (
        "data=example/wall",
        "data.sequences=[wall]",
        "task.criterion=example/tracked",
        "criterion.slack=0.5",
        "augmentation.dark.factor=0.5",
    )
    ran = call(
        "prgbd", "-m", *PLUGINS, *options, "depth.channels=8", "data.frames=12", "+loss.edge.weight=0,0.1", "out=sweep"
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    without, with_edge = (
        list(csv.DictReader((tmp_path / "sweep" / run / "loops/00/training/losses.csv").open())) for run in "01"
    )
    assert {row["edge"] for row in without} == {""}
    assert all(float(row["edge"]) > 0 for row in with_edge)
    assert float(with_edge[0]["total"]) > float(without[0]["total"])
    table = list(csv.DictReader((tmp_path / "sweep" / "ablation.csv").open()))
    assert [row["run"] for row in table] == ["loss.edge.weight=0", "loss.edge.weight=0.1"]
