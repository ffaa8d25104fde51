"""Maps on disk: a second pass through a place is tracked in the map of the first one."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.errors import ConfigError, ContractError, DataError
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.map.map_file import FORMAT
from tests.plugins.slam.orb_gtsam.walls import CAMERA, path, view

POSES = path(46)
# What the first pass maps, and what the second one sees: backwards, between the frames of the first, and beyond.
FIRST = list(range(0, 26, 2))
SECOND = [13, 11, 9, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, *range(27, 46, 2)]
# Measured depth makes a map that reaches further, so that the way on needs a keyframe later than without depth.
PASS = {"rgbd": SECOND, "mono": SECOND[:19]}


def frames_of(indices: list[int]) -> list[Frame]:
    return [view(n, POSES[i]) for n, i in enumerate(indices)]


def begin(mode: str = "rgbd", baseline: float = 0.1, **options) -> OrbGtsamSLAM:
    system = OrbGtsamSLAM(**options)
    system.reset(CAMERA, mode, baseline=None if mode == "mono" else baseline, fps=10.0)
    return system


def track(system: OrbGtsamSLAM, frames: list[Frame]) -> SlamResult:
    with system:
        for frame in frames:
            system.track(frame)
        return system.finish()


@pytest.fixture(scope="module", params=["rgbd", "mono"])
def mapped(request, tmp_path_factory):
    """Mode, file and result of a first pass."""
    file = tmp_path_factory.mktemp("maps") / f"{request.param}.npz"
    with begin(request.param) as system:
        for frame in frames_of(FIRST if request.param == "rgbd" else list(range(26))):
            system.track(frame)
        result = system.finish()
        system.save_map(file)
    return request.param, file, result


def errors_in_the_map(mode: str, first: SlamResult, second: SlamResult, first_frames: list[int]) -> np.ndarray:
    """Position errors of the second pass in metres, in the coordinates (and scale) that the first pass has."""
    truth = np.stack([POSES[first_frames[i]] for i in first.trajectory.frame_index])
    scale = 1.0
    if mode == "mono":
        lengths = [np.linalg.norm(p[-1, :3, 3] - p[0, :3, 3]) for p in (truth, first.trajectory.wTc)]
        scale = lengths[0] / lengths[1]
    mapTworld = first.trajectory.wTc[0] @ np.linalg.inv(truth[0])
    mapTworld[:3, 3] = first.trajectory.wTc[0, :3, 3] * scale - mapTworld[:3, :3] @ truth[0, :3, 3]
    wanted = np.stack([mapTworld @ POSES[SECOND[i]] for i in second.trajectory.frame_index])[:, :3, 3]
    return np.linalg.norm(second.trajectory.positions * scale - wanted, axis=1)


def test_a_second_pass_is_tracked_in_the_coordinates_of_the_first_and_extends_the_map(mapped, tmp_path) -> None:
    mode, file, first = mapped
    system = begin(mode)
    system.load_map(file)
    before = system.view()
    assert before is not None
    assert len(before.keyframes) == len(first.keyframes)
    assert len(before.points) == len(first.points)
    with system:
        for frame in frames_of(PASS[mode]):
            result = system.track(frame)
        second = system.finish()
        system.save_map(tmp_path / "both.npz")
    assert set(second.states) == {"ok"}
    errors = errors_in_the_map(mode, first, second, FIRST if mode == "rgbd" else list(range(26)))
    assert errors.max() < 0.03
    # The way back and forth inside the first map needs few keyframes, the way on needs some.
    assert result.info["maps"] == 1
    assert 0 < len(second.keyframes) < len(PASS[mode])
    assert second.keyframes.frame_index.min() >= 0
    assert len(second.points) > len(first.points)
    # What two passes made is a map like any other.
    again = begin(mode)
    again.load_map(tmp_path / "both.npz")
    view_again = again.view()
    assert view_again is not None
    assert len(view_again.keyframes) > len(before.keyframes)
    third = track(again, frames_of(PASS[mode][::-1]))
    assert set(third.states) == {"ok"}


def test_localising_only_changes_nothing(mapped) -> None:
    mode, file, first = mapped
    system = begin(mode, localise_only=True)
    system.load_map(file)
    before = system.view()
    # Blank frames would start a new map otherwise.
    for n in range(40):
        system.track(Frame(n, n / 10, np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), blank_depth()))
    frames = [Frame(40 + f.index, 4 + f.timestamp, f.image, f.depth) for f in frames_of(SECOND[:8])]
    for frame in frames:
        system.track(frame)
    after = system.view()
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(after.keyframes, before.keyframes)
    np.testing.assert_array_equal(after.points, before.points)
    result = system.finish()
    assert result.states == ["lost"] * 40 + ["ok"] * 8
    assert (len(result.keyframes), len(result.observations)) == (0, 0)
    assert len(result.points) == len(first.points)
    with pytest.raises(ConfigError, match=r"slam\.load_map"):
        track(begin(mode, localise_only=True), frames)


def test_an_unknown_place_becomes_a_second_map_and_both_are_kept(mapped, tmp_path) -> None:
    mode, file, first = mapped
    if mode == "mono":
        pytest.skip("the same with more frames")
    system = begin(mode, tracking={"restart_after": 3})
    system.load_map(file)
    elsewhere = np.eye(4)
    elsewhere[0, 3] = 9.0
    with system:
        results = [system.track(view(n, elsewhere @ POSES[n])) for n in range(8)]
        found = system.finish()
        system.save_map(tmp_path / "two.npz")
    assert found.states == ["lost"] * 2 + ["ok"] * 6
    assert [r.info["maps"] for r in results] == [1] * 2 + [2] * 6
    assert found.stats["loaded_keyframes"] == len(first.keyframes)
    assert len(np.unique(found.keyframes.map_id)) == 1
    # The larger of the two is the one to start in.
    again = begin(mode)
    again.load_map(tmp_path / "two.npz")
    assert len(again._map.map_ids()) == 2
    assert len(again._map.alive()) == len(first.keyframes)
    third = track(again, frames_of(SECOND[:6]))
    assert set(third.states) == {"ok"}
    assert errors_in_the_map(mode, first, third, FIRST).max() < 0.03


def blank_depth() -> np.ndarray:
    return np.zeros((CAMERA.height, CAMERA.width), np.float32)


def test_loading_and_saving_is_exact_and_repeatable(mapped, tmp_path) -> None:
    mode, file, _ = mapped
    stored = []
    for name in ("a.npz", "b.npz"):
        system = begin(mode)
        system.load_map(file)
        system.save_map(tmp_path / name)
        stored.append((tmp_path / name).read_bytes())
    assert stored[0] == stored[1]
    with np.load(file) as old, np.load(tmp_path / "a.npz") as new:
        assert set(old.files) == set(new.files)
        for name in set(old.files) - {"header", "keyframes.frame_index"}:
            np.testing.assert_array_equal(old[name], new[name], err_msg=name)
        np.testing.assert_array_equal(new["keyframes.frame_index"], -1 - old["keyframes.frame_index"])


def test_culled_keyframes_and_points_are_left_out_and_nothing_refers_to_them(tmp_path) -> None:
    with begin() as system:
        for frame in frames_of(FIRST):
            system.track(frame)
        slam_map = system._map
        kept, gone = slam_map.alive()[:2].tolist()
        assert len(slam_map.alive()) > 2
        slam_map.cull_keyframe(gone, kept)
        pts = slam_map.points
        assert np.any(pts.reference[: pts.count][~pts.bad[: pts.count]] == gone)
        system.save_map(tmp_path / "m.npz")
        keyframes, points = len(slam_map.alive()), int(np.count_nonzero(pts.head[: pts.count] >= 0))
    again = begin()
    again.load_map(tmp_path / "m.npz")
    slam_map = again._map
    assert (slam_map.keyframes.count, slam_map.points.count) == (keyframes, points)
    assert not slam_map.keyframes.bad[:keyframes].any()
    reference = slam_map.points.reference[:points]
    assert reference.min() >= 0
    assert reference.max() < keyframes
    assert slam_map.observation_counts(np.arange(points), double=False).min() > 0


def test_another_baseline_moves_the_virtual_right_image(mapped) -> None:
    mode, file, _ = mapped
    if mode == "mono":
        pytest.skip("mono has no baseline")
    system = begin(mode, baseline=0.2)
    system.load_map(file)
    kf = system._map.keyframes
    measured = (kf.u_right[: kf.count] >= 0) & (kf.depth[: kf.count] > 0)
    assert measured.any()
    disparity = (kf.uv[: kf.count, :, 0] - kf.u_right[: kf.count])[measured]
    np.testing.assert_allclose(disparity, 0.2 * CAMERA.fx / kf.depth[: kf.count][measured], rtol=1e-3)


def test_a_refined_focal_length_comes_back_and_the_camera_is_still_known(mapped, tmp_path) -> None:
    mode, file, _ = mapped
    system = begin(mode)
    system.load_map(file)
    system._camera.pinhole = replace(system._camera.pinhole, fx=CAMERA.fx * 1.01, fy=CAMERA.fy * 1.01)
    system.save_map(tmp_path / "refined.npz")
    again = begin(mode)
    again.load_map(tmp_path / "refined.npz")
    assert again._camera.pinhole.fx == pytest.approx(CAMERA.fx * 1.01)


def test_what_does_not_fit_is_said_in_one_sentence(mapped, tmp_path) -> None:
    mode, file, _ = mapped
    other = PinholeCamera(CAMERA.width, CAMERA.height, CAMERA.fx + 1, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    system = OrbGtsamSLAM()
    system.reset(other, mode, baseline=0.1)
    with pytest.raises(ConfigError, match=r"different cameras.*use the same camera"):
        system.load_map(file)
    with pytest.raises(ConfigError, match=f"made in mode {mode}"):
        begin("mono" if mode == "rgbd" else "rgbd").load_map(file)
    with pytest.raises(ConfigError, match=r"slam\.features\.levels=8 and slam\.features\.scale_factor=1\.2;"):
        begin(mode, features={"levels": 6}).load_map(file)
    with pytest.raises(ConfigError, match=r"set slam\.features\.count="):
        begin(mode, features={"count": 200}).load_map(file)
    with pytest.raises(DataError, match=r"There is no file .*absent\.npz"):
        begin(mode).load_map(tmp_path / "absent.npz")
    late = begin(mode)
    late.track(frames_of([0])[0])
    with pytest.raises(ContractError, match="between reset and track"):
        late.load_map(file)
    with pytest.raises(ContractError, match="no map to save"):
        OrbGtsamSLAM().save_map(tmp_path / "x.npz")


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.99])
def test_a_truncated_map_is_named(mapped, tmp_path, keep) -> None:
    mode, file, _ = mapped
    data = file.read_bytes()
    (tmp_path / "cut.npz").write_bytes(data[: int(keep * len(data))])
    with pytest.raises(DataError, match=r"cut\.npz is not a whole map"):
        begin(mode).load_map(tmp_path / "cut.npz")


def test_another_version_and_other_files_are_named(mapped, tmp_path) -> None:
    mode, file, _ = mapped
    with np.load(file) as stored:
        arrays = dict(stored)
    header = json.loads(str(arrays["header"]))
    np.savez(tmp_path / "new.npz", **{**arrays, "header": json.dumps({**header, "format": FORMAT + 1})})
    with pytest.raises(DataError, match=f"has format {FORMAT + 1}.*reads format {FORMAT}"):
        begin(mode).load_map(tmp_path / "new.npz")
    np.savez(tmp_path / "foreign.npz", a=1)
    np.savez(tmp_path / "pickle.npz", header=np.array([object()], dtype=object))
    (tmp_path / "text.npz").write_text("hello")
    for name in ("foreign", "pickle", "text"):
        with pytest.raises(DataError, match=f"{name}.npz is not a whole map"):
            begin(mode).load_map(tmp_path / f"{name}.npz")
    broken = arrays["keypoints.point"].copy()
    broken[0] = 10**6
    np.savez(tmp_path / "broken.npz", **{**arrays, "keypoints.point": broken})
    with pytest.raises(DataError, match=r"'keypoints\.point' has the value 1e\+06, which is out of range"):
        begin(mode).load_map(tmp_path / "broken.npz")
