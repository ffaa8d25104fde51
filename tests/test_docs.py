"""What README and docs show is true: Python is executed, commands are composed and checked, YAML and TOML are read.

A block right below ``<!-- not run: REASON -->`` is left alone.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import subprocess
import sys
import textwrap
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console

import prgbd
from prgbd.cli.arguments import normalise, value_of
from prgbd.cli.option_help import print_option_help
from prgbd.cli.options import read_options
from prgbd.cli.settings import check_machine
from prgbd.core.registry import REGISTRY
from tests.cli.test_config import composed
from tests.conftest import ROOT
from tests.loop import fakes

FILES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
_FENCE = re.compile(
    r"(?:<!-- not run: (?P<reason>[^>]+) -->\s*\n)?^(?P<indent> *)```(?P<language>\w*)\n(?P<text>.*?)^ *```$",
    re.M | re.S,
)
_INLINE = re.compile(r"`(python -m prgbd[^`]*)`")


@dataclass(frozen=True)
class Block:
    file: Path
    line: int
    language: str
    text: str
    reason: str | None

    def __str__(self) -> str:
        return f"{self.file.name}:{self.line}"


def blocks_of(file: Path) -> list[Block]:
    text = file.read_text(encoding="utf-8")
    return [
        Block(
            file,
            text[: found.start("text")].count("\n"),
            found["language"],
            textwrap.dedent(found["text"]),
            found["reason"],
        )
        for found in _FENCE.finditer(text)
    ]


BLOCKS = [block for file in FILES for block in blocks_of(file)]


def of_language(*languages: str) -> list[Block]:
    return [block for block in BLOCKS if block.language in languages and block.reason is None]


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with what the examples read, where they leave what the next ones read."""
    import cv2

    folder = tmp_path_factory.mktemp("docs")
    world = prgbd.make_data("synthetic", sequence="street-0", frames=40)
    size = (world.camera.width, world.camera.height)
    video = cv2.VideoWriter(str(folder / "drive.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, size)
    for index in range(40):
        video.write(cv2.cvtColor(world.frame(index).image, cv2.COLOR_RGB2BGR))
    video.release()
    (folder / "some/small/folder").mkdir(parents=True)
    _photograph_board(folder / "board")
    return folder


def _photograph_board(folder: Path, views: int = 12) -> None:
    """Photos of a checkerboard of 9 x 6 inner corners by a camera of 480x360 pixels with fx = fy = 420."""
    import cv2

    squares = np.kron(np.indices((9, 12)).sum(0) % 2, np.ones((40, 40))).astype(np.uint8) * 255
    squares[:40] = squares[-40:] = squares[:, :40] = squares[:, -40:] = 255
    K = np.array([[420.0, 0, 239.5], [0, 420, 179.5], [0, 0, 1]])
    squares_of_pixels = np.array([[1 / 40, 0, -6], [0, 1 / 40, -4.5], [0, 0, 1]])
    folder.mkdir()
    for i in range(views):
        R, _ = cv2.Rodrigues(np.array([0.5 * np.sin(i), 0.5 * np.cos(1.7 * i), 0.1 * i]))
        t = np.array([0.6 * np.cos(i), 0.5 * np.sin(2 * i), 13.0 + i % 3])
        H = K @ np.column_stack([R[:, 0], R[:, 1], t]) @ squares_of_pixels
        photo = cv2.warpPerspective(squares, H, (480, 360), flags=cv2.INTER_AREA, borderValue=255)
        cv2.imwrite(str(folder / f"{i:02}.png"), cv2.GaussianBlur(photo, (0, 0), 0.7))


@pytest.fixture
def plugins(place, monkeypatch):
    """The plug-ins that the examples call the reader's own; the network is that of docs/own-depth.md."""
    monkeypatch.setattr(REGISTRY, "_specs", dict(REGISTRY._specs))
    for kind, name, target in (("slam", "myslam", "Sideways"), ("data", "mydata", "Wall")):
        getattr(prgbd, f"register_{kind}")(f"lab/{name}", f"{fakes.__name__}:{target}", "")
    (network,) = [block for block in BLOCKS if "class MyNet" in block.text]
    (place / "mynet.py").write_text(network.text)
    monkeypatch.syspath_prepend(place)
    yield
    sys.modules.pop("mynet", None)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_python_runs(file, place, plugins, monkeypatch, capsys):
    """In the order of the file, in one folder, each block by itself; functions named test_... are called."""
    monkeypatch.chdir(place)
    for block in of_language("python"):
        if block.file != file:
            continue
        names: dict = {"__name__": "example"}
        exec(compile(block.text, str(block), "exec"), names)
        for name in [name for name in names if name.startswith("test_")]:
            names[name]()


def test_the_result_of_the_example_is_a_trajectory(place, monkeypatch, plugins, capsys):
    """The numbers that docs/slam.md prints make sense: the frames have poses, and the first is found in its map."""
    test_python_runs(ROOT / "docs" / "slam.md", place, plugins, monkeypatch, capsys)
    assert "of 40 frames have a pose" in capsys.readouterr().out
    result = prgbd.load_result(place / "out")
    assert result.tracked_frames > 30
    assert np.isfinite(prgbd.to_evo(result.trajectory).positions_xyz).all()


def test_the_calibration_of_the_example_is_right(place, monkeypatch, plugins, capsys):
    """docs/own-video.md writes a camera file that fits the camera that took the photos, and that prgbd reads."""
    test_python_runs(ROOT / "docs" / "own-video.md", place, plugins, monkeypatch, capsys)
    video = prgbd.make_data("images", root=place / "board", camera=place / "camera.yaml")
    assert abs(video.camera.fx / 420 - 1) < 0.02
    assert abs(video.camera.cx - 239.5) < 3


def test_the_site_builds_without_warnings(tmp_path):
    for module in ("mkdocs", "material", "mkdocstrings", "griffe"):
        pytest.importorskip(module, reason="the site needs the extra 'docs'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert built.returncode == 0, built.stdout + built.stderr
    assert "WARNING" not in built.stdout + built.stderr
    for page in ("index", "troubleshooting", "api-core"):
        assert (tmp_path / "site" / f"{page}.html").is_file()
    for page in (tmp_path / "site").glob("*.html"):
        loaded = re.findall(
            r'<(?:script|link|img)[^>]*(?:src|href)="?https?://[^"> ]+', page.read_text(encoding="utf-8")
        )
        assert not loaded, f"{page.name} loads from another server: {loaded}"
    assert "PinholeCamera" in (tmp_path / "site" / "api-core.html").read_text(encoding="utf-8")


def commands() -> list[tuple[str, str]]:
    """Every command of the documentation with its place: lines of bash blocks, and inline ones."""
    found = []
    for block in of_language("bash", "sh"):
        lines = block.text.replace("\\\n", " ").splitlines()
        found += [(str(block), line) for line in lines if line.strip() and not line.startswith("#")]
    for file in FILES:
        outside = _FENCE.sub("", file.read_text(encoding="utf-8"))
        found += [(file.name, command) for command in _INLINE.findall(outside)]
    return list(dict.fromkeys(found))


@pytest.mark.parametrize(("where", "command"), commands())
def test_commands_are_understood(where, command, tmp_path, monkeypatch):
    words = shlex.split(command, comments=True)
    if words[:2] == ["python", "-m"]:
        assert importlib.util.find_spec(words[2]) is not None, where
        if words[2:4] == ["prgbd", "--help"]:
            for name in words[4:]:
                print_option_help(Console(quiet=True), name)
        elif words[2] == "prgbd":
            monkeypatch.chdir(tmp_path)
            _check_run(words[3:])
    elif words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.M), where
    else:
        assert words[:2] == ["pip", "install"] or words[0] == "rerun", f"{where} shows what no test knows: {command}"


def _check_run(words: list[str]) -> None:
    words = _with_installed_plugins(words)
    words = [re.sub(r"=\.\.\.$", "=synthetic", word) for word in words if word not in ("-m", "--help")]
    words = [word.split(",")[0] if "," in word and "[" not in word else word for word in words]
    if "--cfg" in words:
        words = words[: words.index("--cfg")]
    if value_of(normalise(words), "resume"):
        return
    loaded = value_of(normalise(words), "slam.load_map")
    if loaded:
        Path(loaded).touch()
    if (value_of(words, "viz") or "none") != "none" and importlib.util.find_spec("rerun") is None:
        words = [word for word in words if not word.startswith("viz=")]
    config = composed(*[word for word in words if not word.startswith("out=")])
    config["out"] = "run"
    check_machine(read_options(config), config)
    _check_plugin_options(words, config)


def _with_installed_plugins(words: list[str]) -> list[str]:
    """Plug-ins that the reader is to write, or to install, are installed by ``test_third_party*``; not here."""
    foreign = {
        kind
        for kind in ("slam", "depth")
        for word in words
        if re.match(rf"\+*{kind}=(mynet|lab/\w+|example/\w+)$", word)
    }
    kept = [word for word in words if "experiment=example_" not in word]
    kept = [word for word in kept if not any(re.match(rf"\+*{kind}[.=]", word) for kind in foreign)]
    return kept + [{"slam": "slam=orb_gtsam", "depth": "depth=monodepth2"}[kind] for kind in sorted(foreign)]


def _check_plugin_options(words: list[str], config: dict) -> None:
    """Options of plug-ins pass the command line unseen, so they are looked up where the plug-in has them."""
    from prgbd.cli.hydra_bridge import options_class
    from prgbd.cli.plugin_choices import LOOP_KEYS
    from prgbd.core.options import option_types

    for word in words:
        found = re.match(r"\+*(slam|depth|data)\.([\w.]+)=", word)
        if found is None or found[2] in (*LOOP_KEYS[found[1]], "id"):
            continue
        plugin = value_of([w.lstrip("+") for w in words], found[1]) or config[found[1]]["id"]
        spec = REGISTRY.resolve(found[1], plugin)
        if spec.missing:
            continue  # its extra is not installed here
        named = options_class(spec)
        known = set(REGISTRY.options(found[1], plugin) if named is None else option_types(named))
        assert found[2] in known, f"{word}: {plugin} has {sorted(known)}"


@pytest.mark.parametrize("block", of_language("yaml", "toml"), ids=str)
def test_files_are_well_formed(block):
    read = yaml.safe_load if block.language == "yaml" else tomllib.loads
    assert read(block.text)


def test_every_block_has_a_known_language():
    assert {block.language for block in BLOCKS} <= {"", "python", "bash", "sh", "yaml", "toml"}


# The README is shown on PyPI too, so its links are absolute.
_IN_REPOSITORY = re.compile(
    r"https://(?:github\.com/prgbd/prgbd/(?:blob|tree)|raw\.githubusercontent\.com/prgbd/prgbd)/main/"
)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_links_lead_somewhere(file):
    text = _FENCE.sub("", file.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)#]+)", text):
        here = _IN_REPOSITORY.match(target)
        if here:
            assert (ROOT / target[here.end() :]).exists(), target
        elif not target.startswith(("https://", "http://")):
            assert (file.parent / target).exists(), target
            assert file.name != "README.md", f"{target}: PyPI knows no files beside the README"
