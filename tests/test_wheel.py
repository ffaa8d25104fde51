"""The wheel holds what git tracks under conf/ and prgbd/ and nothing else, and runs far from the checkout."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.conftest import ROOT

pytestmark = pytest.mark.skipif(
    not (ROOT / ".git").exists() or importlib.util.find_spec("build") is None,
    reason="needs a checkout by git, and the package 'build' of the extra 'dev'",
)


def run(*command: str, cwd: Path, path: str | None = None) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if path is not None:
        environment["PYTHONPATH"] = path
    ran = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stdout[-2000:] + ran.stderr
    return ran.stdout


def checkout() -> list[str]:
    """What git tracks, or would after ``git add``; without what is deleted but not yet committed."""
    listed = run("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", cwd=ROOT)
    return [name for name in listed.split("\0") if name and (ROOT / name).is_file()]


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """A copy of the checkout without what git ignores; weights are cut to 1 kB, for they take most of the time."""
    folder = tmp_path_factory.mktemp("source")
    for name in checkout():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if name.endswith(".pth"):
            (folder / name).write_bytes((ROOT / name).read_bytes()[:1024])
        else:
            shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module", params=["from the checkout", "through the sdist"])
def wheel(request, source, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    kind = ("--wheel",) if request.param == "from the checkout" else ()  # without a choice: sdist, then wheel from it
    printed = run(sys.executable, "-m", "build", "--no-isolation", *kind, "--outdir", str(out), str(source), cwd=out)
    assert "would be ignored" not in printed  # setuptools' word for files in folders that no package names
    (built,) = out.glob("*.whl")
    return built


def test_it_holds_the_files_of_the_checkout_and_no_other(wheel, source) -> None:
    with ZipFile(wheel) as archive:
        packed = {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}
    tracked = {name: (source / name).read_bytes() for name in checkout() if name.startswith(("conf/", "prgbd/"))}
    expected = {f"prgbd/{name}" if name.startswith("conf/") else name: data for name, data in tracked.items()}
    assert sorted(packed) == sorted(expected)
    assert [name for name in packed if packed[name] != expected[name]] == []


def test_it_runs_unpacked_in_another_folder(wheel, tmp_path) -> None:
    with ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    # -S leaves out the .pth files, which would bring the editable installation of the checkout back.
    installed = [entry for entry in sys.path if Path(entry).name in ("site-packages", "dist-packages")]
    path = os.pathsep.join([str(tmp_path / "site"), *installed])
    program = "import prgbd.conf; print(prgbd.conf.__file__, prgbd.__file__, sep='\\n')"
    found = run(sys.executable, "-S", "-c", program, cwd=tmp_path, path=path).splitlines()
    assert [Path(file).parent for file in found] == [tmp_path / "site/prgbd/conf", tmp_path / "site/prgbd"]
    assert "orb_gtsam" in run(sys.executable, "-S", "-m", "prgbd", "--help", cwd=tmp_path, path=path)
