"""A package of one file with one entry point and no YAML, installed by pip, is run by its id."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

PYPROJECT = """
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "prgbd-test-lab"
version = "1.2.3"
description = "A tiny depth network of somebody else"

[project.entry-points."prgbd.depth"]
"lab/tiny-v1" = "prgbd_test_lab:Tiny"
"lab/broken" = "prgbd_test_lab_that_is_absent:Broken"

[tool.setuptools]
py-modules = ["prgbd_test_lab"]
"""

MODULE = '''
"""A depth network: the lower a pixel, the nearer; two numbers are learnt."""

import torch
from torch import nn

from prgbd import DepthEstimator, DepthPrediction


class Tiny(DepthEstimator):
    input_size = (64, 96)
    depth_range = (0.5, 80.0)
    metric = False

    def __init__(self, weights=None, nearest=4.0):
        super().__init__()
        self.slope = nn.Parameter(torch.tensor([1.5, float(nearest)]))
        if weights is not None:
            self.load_weights(weights)

    def forward(self, images):
        rows = torch.linspace(1, 0, images.shape[2], device=images.device)[None, None, :, None]
        depth = self.slope[1].abs() * torch.exp(self.slope[0] * rows) + 0.1 * images.mean(1, keepdim=True)
        return DepthPrediction((depth.expand(-1, 1, *images.shape[2:]).clamp(*self.depth_range),))
'''


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *arguments], cwd=cwd, capture_output=True, text=True, timeout=400)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Install the package into the environment of the tests and take it out again."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "pyproject.toml").write_text(PYPROJECT)
    (folder / "prgbd_test_lab.py").write_text(MODULE)
    pip = ("pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check")
    installed = run(*pip, ".", cwd=folder)
    assert installed.returncode == 0, installed.stderr
    yield folder
    run("pip", "uninstall", "--quiet", "--yes", "prgbd-test-lab", cwd=folder)


def test_it_is_listed_with_where_it_comes_from(lab) -> None:
    listing = run("prgbd.plugins", "depth", cwd=lab)
    assert listing.returncode == 0
    line = next(line for line in listing.stdout.splitlines() if line.startswith("lab/tiny-v1"))
    assert "somebody else" in line
    assert "prgbd-test-lab 1.2.3" in line


def test_it_keeps_the_contract(lab) -> None:
    program = "import prgbd; prgbd.check_depth_estimator(prgbd.make_depth('lab/tiny', nearest=3.0))"
    checked = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stderr


def test_the_loop_runs_it_by_its_id(lab, tmp_path) -> None:
    ran = run("prgbd", "+slam=orb_gtsam", "+depth=lab/tiny", "depth.nearest=3.5", "experiment=smoke",
              f"hydra.run.dir={tmp_path}/run", cwd=lab)  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["depth"].startswith("lab/tiny")
    assert len(summary["loops"]) >= 2
    assert (tmp_path / "run" / "report.html").is_file()


def test_a_task_runs_it_by_its_id_with_version_and_without_plus(lab, tmp_path) -> None:
    ran = run("prgbd", "depth=lab/tiny-v1", "depth.nearest=3.5", "task=depth", "data=synthetic", "data.frames=2",
              f"hydra.run.dir={tmp_path}/run", cwd=lab)  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["depth"].startswith("lab/tiny")


def test_its_broken_neighbour_is_named_in_one_sentence(lab, tmp_path) -> None:
    ran = run("prgbd", "+slam=orb_gtsam", "+depth=lab/broken", f"hydra.run.dir={tmp_path}/run", cwd=lab)
    assert ran.returncode == 2
    assert "lab/broken" in ran.stderr
    assert "prgbd_test_lab_that_is_absent" in ran.stderr
    assert "Traceback" not in ran.stderr
