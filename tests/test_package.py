"""What holds of the package as a whole: imports run down the floors, importing is light, the face is complete."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import prgbd

ROOT = Path(__file__).resolve().parents[1]


def test_imports_run_down_the_floors() -> None:
    pytest.importorskip("importlinter", reason="import-linter comes with the extra 'dev'")
    program = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports())"
    linted = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert linted.returncode == 0, linted.stdout


def test_importing_prgbd_loads_nothing_heavy() -> None:
    program = (
        "import sys, prgbd; prgbd.core.registry.specs('slam'); "
        "print([m for m in ('torch', 'lightning', 'cv2', 'gtsam', 'numba', 'evo', 'matplotlib') if m in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    for name in prgbd.__all__:
        assert getattr(prgbd, name) is not None
    assert set(dir(prgbd)) == set(prgbd.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        prgbd.nonsense  # noqa: B018


@pytest.mark.parametrize("tool", ["ruff", "codespell"])
def test_hooks_have_the_versions_of_the_constraints(tool) -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    (revision,) = (entry["rev"] for entry in hooks if tool in entry["repo"])
    assert f"{tool}=={revision.removeprefix('v')}" in (ROOT / "constraints.txt").read_text().splitlines()
