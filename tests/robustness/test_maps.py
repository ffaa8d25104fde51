"""Map files and SLAM results that somebody damaged: refused in one sentence, or good enough to go on with."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prgbd.core.errors import DataError
from prgbd.core.types import Keyframes, MapPoints, Observations, SlamResult, Trajectory
from prgbd.io.arrays import Entry, read_arrays
from prgbd.io.export import load_result, save_arrays
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from tests.plugins.slam.orb_gtsam.walls import CAMERA, path, view
from tests.robustness.fuzzing import examples, judged

POSES = path(20)
WHOLE = [-(2**63), -(2**31), -100, -1, 0, 1, 7, 1000, 10**6, 2**31 - 1, 2**63 - 1]
BROKEN = [1e-300, 1e12, 1e300, -1e30, float("nan"), float("inf"), float("-inf"), 0.5, -0.0]
WILD = st.sampled_from([*WHOLE, *BROKEN])
TYPES = st.sampled_from(["f4", "f8", "i4", "i8", "u1", "u8", "?", "c16", "U3", "f2", ">i8"])


@st.composite
def damaged(draw: st.DrawFn, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Change one or two entries of a file: a number, a type, a shape, or whether it is there."""
    changed = dict(arrays)
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(sorted(changed)))
        array = changed.pop(name)
        how = draw(st.sampled_from(["number", "number", "number", "all", "type", "shape", "header", "drop", "twice"]))
        if how == "header" or (name == "header" and how in ("number", "all")):
            text = str(arrays["header"])
            at = draw(st.integers(0, len(text) - 1))
            piece = draw(st.sampled_from(["", "-", "NaN", "null", "[]", "{", "1e999", "9" * 30, '"']))
            changed["header"] = np.array(text[:at] + piece + text[at + draw(st.integers(0, 3)) :])
        elif how in ("number", "all") and array.size and array.dtype.kind in "fiu":
            array, value = array.copy(), draw(WILD)
            place = ... if how == "all" else np.unravel_index(draw(st.integers(0, array.size - 1)), array.shape)
            with np.errstate(all="ignore"):
                array[place] = np.array(value).astype(array.dtype)
            changed[name] = array
        elif how == "type":
            with np.errstate(all="ignore"):
                changed[name] = array.astype(draw(TYPES)) if array.dtype.kind in "fiub" else np.zeros(3)
        elif how == "shape":
            shapes = [array[..., None], array.reshape(-1), array[:0] if array.ndim else array, array[None]]
            changed[name] = draw(st.sampled_from([*shapes, np.concatenate([shapes[1], shapes[1]])]))
        elif how == "twice":
            changed |= {name: array, f"{name}.{name}": array}
    return Damaged(changed)


class Damaged(dict[str, np.ndarray]):
    """Arrays by name that do not fill the screen where a test fails."""

    def __repr__(self) -> str:
        return str({name: (array.dtype, array.shape) for name, array in self.items()})


@pytest.fixture(scope="module", params=["rgbd", "mono"])
def mapped(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A mode and the map of a short pass in it."""
    file = tmp_path_factory.mktemp("maps") / "map.npz"
    with begin(request.param) as system:
        for index, pose in enumerate(POSES):
            system.track(view(index, pose))
        system.finish()
        system.save_map(file)
    return request.param, file


def begin(mode: str) -> OrbGtsamSLAM:
    system = OrbGtsamSLAM()
    system.reset(CAMERA, mode, baseline=None if mode == "mono" else 0.1, fps=10.0)
    return system


def go_on(mode: str, file: Path) -> None:
    """Load a map, track in it and end, which uses all that is in it."""
    with begin(mode) as system:
        system.load_map(file)
        for index, pose in enumerate(POSES[9:3:-2]):
            system.track(view(index, pose))
        system.finish()


@examples(small=12, large=250)
@given(data=st.data())
def test_damaged_entries_of_maps(mapped: tuple[str, Path], data: st.DataObject) -> None:
    mode, file = mapped
    with np.load(file) as archive:
        arrays = {name: archive[name] for name in archive.files}
    np.savez(file.with_name("damaged.npz"), **data.draw(damaged(arrays)))
    with judged("map files: entries"):
        go_on(mode, file.with_name("damaged.npz"))


@examples(small=12, large=150)
@given(at=st.floats(0, 1), piece=st.binary(max_size=8), cut=st.booleans())
def test_damaged_bytes_of_maps(mapped: tuple[str, Path], at: float, piece: bytes, cut: bool) -> None:
    mode, file = mapped
    whole = file.read_bytes()
    start = int(at * len(whole))
    file.with_name("damaged.npz").write_bytes(whole[:start] + piece + (b"" if cut else whole[start + len(piece) :]))
    with judged("map files: bytes"):
        go_on(mode, file.with_name("damaged.npz"))


def small_result() -> SlamResult:
    wTc, index = np.tile(np.eye(4), (3, 1, 1)), np.arange(3)
    return SlamResult(
        camera=CAMERA,
        mode="mono",
        frames=3,
        trajectory=Trajectory(index, index / 10, wTc),
        keyframes=Keyframes(index, index / 10, wTc, np.zeros(3, np.int64)),
        points=MapPoints(np.ones((4, 3)), np.zeros((4, 3), np.uint8)),
        observations=Observations(np.array([0, 2]), np.array([1, 3]), np.ones((2, 2)), np.ones(2)),
        states=["ok"] * 3,
        inliers=np.ones(3, np.int32),
        online=None,
        stats={"keyframes": 3},
    )


@examples(small=60, large=600)
@given(data=st.data())
def test_damaged_entries_of_results(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    folder = tmp_path_factory.getbasetemp()
    save_arrays(small_result(), folder / "result.npz")
    with np.load(folder / "result.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    np.savez(folder / "damaged.npz", **data.draw(damaged(arrays)))
    with judged("SLAM results"):
        result = load_result(folder / "damaged.npz")
        assert np.isfinite(result.trajectory.wTc).all()
        assert len(result.points.xyz) > result.observations.point.max(initial=-1)


def test_a_small_file_that_claims_gigabytes_is_refused_unread(tmp_path: Path) -> None:
    bomb = tmp_path / "bomb.npz"
    with zipfile.ZipFile(bomb, "w") as archive, archive.open("column.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (2**33, 3)})
    with pytest.raises(DataError, match="it claims to hold 192 GiB"):
        read_arrays(bomb, {"column": Entry("f", ("N", 3))}, "bomb")
