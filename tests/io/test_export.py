import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory
from prgbd.io.export import load_result, save_arrays, save_result, write_ply
from prgbd.io.trajectory_files import read_kitti, read_tum, to_evo, write_kitti, write_tum


def make_trajectory(frames, seed=0):
    rng = np.random.default_rng(seed)
    wTc = np.tile(np.eye(4), (len(frames), 1, 1))
    wTc[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(len(frames), 3))).as_matrix()
    wTc[:, :3, 3] = rng.normal(size=(len(frames), 3)) * 100
    frames = np.asarray(frames, np.int64)
    return Trajectory(frames, 1311868164.363181 + frames / 30, wTc)


def make_result(online=True):
    rng = np.random.default_rng(3)
    trajectory = make_trajectory([1, 2, 3, 5])
    return SlamResult(
        camera=PinholeCamera(64, 48, 50.0, 51.0, 31.5, 23.25),
        mode="rgbd",
        frames=7,
        trajectory=trajectory,
        keyframes=Keyframes(
            trajectory.frame_index[:2], trajectory.timestamp[:2], trajectory.wTc[:2], np.zeros(2, "i4")
        ),
        points=MapPoints(rng.normal(size=(9, 3)), rng.integers(0, 256, (9, 3), np.uint8)),
        observations=Observations(
            rng.integers(0, 2, 12), rng.integers(0, 9, 12), rng.random((12, 2), "f4"), rng.random(12, "f4")
        ),
        states=["not_initialized", "ok", "ok", "ok", "lost", "ok", "lost"],
        inliers=np.arange(7, dtype=np.int32),
        online=make_trajectory([1, 2, 3, 5], seed=1) if online else None,
        stats={"track_ms": np.float32(1.5), "loops": [1, 2], "nan": np.nan},
    )


@pytest.mark.parametrize("online", [True, False])
def test_a_result_reads_back_bit_for_bit(tmp_path, online):
    result = make_result(online)
    save_arrays(result, tmp_path / "r.npz")
    again = load_result(tmp_path / "r.npz")
    assert (again.camera, again.mode, again.frames) == (result.camera, result.mode, result.frames)
    assert again.states == result.states
    assert again.stats == {"track_ms": 1.5, "loops": [1, 2], "nan": None}
    parts = ["trajectory", "keyframes", "points", "observations"] + ["online"] * online
    assert (again.online is None) == (not online)
    for part in parts:
        for name, column in vars(getattr(result, part)).items():
            read = getattr(getattr(again, part), name)
            assert read.dtype == column.dtype
            np.testing.assert_array_equal(read, column)
    np.testing.assert_array_equal(again.inliers, result.inliers)
    save_arrays(result, tmp_path / "r2.npz")
    assert (tmp_path / "r.npz").read_bytes() == (tmp_path / "r2.npz").read_bytes()


def test_an_empty_result_survives_every_export(tmp_path):
    result = make_result()
    nothing = SlamResult(
        camera=result.camera,
        mode="mono",
        frames=3,
        trajectory=Trajectory.empty(),
        keyframes=Keyframes(np.zeros(0, "i8"), np.zeros(0), np.zeros((0, 4, 4)), np.zeros(0, "i4")),
        points=MapPoints(np.zeros((0, 3)), np.zeros((0, 3), "u1")),
        observations=Observations(np.zeros(0, "i8"), np.zeros(0, "i8"), np.zeros((0, 2), "f4"), np.zeros(0, "f4")),
        states=["lost"] * 3,
        inliers=np.zeros(3, "i4"),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save_result(nothing, tmp_path)
    assert len(load_result(tmp_path / "result.npz").trajectory) == 0
    assert len(read_tum(tmp_path / "trajectory.tum")) == 0
    np.testing.assert_array_equal(read_kitti(tmp_path / "trajectory.kitti").wTc, np.tile(np.eye(4), (3, 1, 1)))


def test_the_slam_folder_has_the_whole_contract(tmp_path):
    save_result(make_result(), tmp_path / "s")
    assert {p.name for p in (tmp_path / "s").iterdir()} == {
        "result.npz", "trajectory.tum", "trajectory.kitti", "keyframes.tum", "keyframes.kitti", "online.tum",
        "map.ply", "slam.json",
    }  # fmt: skip


def test_a_result_saves_and_loads_itself(tmp_path):
    result = make_result()
    save_result(result, tmp_path / "out")
    assert (tmp_path / "out" / "map.ply").is_file()
    for path in (tmp_path / "out", str(tmp_path / "out" / "result.npz")):
        again = load_result(path)
        np.testing.assert_array_equal(again.trajectory.wTc, result.trajectory.wTc)
        np.testing.assert_array_equal(again.observations.uv, result.observations.uv)
        assert again.states == result.states
    np.testing.assert_array_equal(to_evo(again.trajectory).poses_se3, result.trajectory.wTc)
    np.testing.assert_array_equal(to_evo(again.trajectory).timestamps, result.trajectory.timestamp)
    with pytest.raises(DataError, match="no SLAM result"):
        load_result(tmp_path)


def test_only_the_formats_that_are_asked_for_are_written(tmp_path):
    save_result(make_result(), tmp_path / "a", formats=["colmap"])
    assert {p.name for p in (tmp_path / "a").iterdir()} == {"result.npz", "slam.json", "colmap"}
    save_result(make_result(), tmp_path / "b", formats=())
    assert {p.name for p in (tmp_path / "b").iterdir()} == {"result.npz", "slam.json"}
    with pytest.raises(ConfigError, match="'colmp'; did you mean 'colmap'"):
        save_result(make_result(), tmp_path / "c", formats=["colmp"])
    assert not (tmp_path / "c").exists()
    with pytest.raises(ConfigError, match="needs the frames"):
        save_result(make_result(), tmp_path / "c", formats=["colmap_images"])


@pytest.mark.parametrize("keep", [0, 10, 0.3, 0.9, 0.999])
def test_a_truncated_result_is_a_data_error(tmp_path, keep):
    path = tmp_path / "r.npz"
    save_arrays(make_result(), path)
    data = path.read_bytes()
    path.write_bytes(data[: keep if isinstance(keep, int) else int(keep * len(data))])
    with pytest.raises(DataError, match=r"r\.npz"):
        load_result(path)


def test_a_flipped_byte_and_a_foreign_archive_are_data_errors(tmp_path):
    path = tmp_path / "r.npz"
    save_arrays(make_result(), path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(DataError):
        load_result(path)
    np.savez(path, a=1)
    with pytest.raises(DataError):
        load_result(path)
    np.savez(path, header=np.array([object()], dtype=object))
    with pytest.raises(DataError):
        load_result(path)
    with pytest.raises(DataError, match="no SLAM result"):
        load_result(tmp_path / "absent.npz")


def test_tum_reads_back_and_evo_reads_the_same(tmp_path):
    from evo.tools.file_interface import read_tum_trajectory_file

    trajectory = make_trajectory([0, 1, 4])
    write_tum(trajectory, tmp_path / "t.tum")
    again = read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(again.timestamp, trajectory.timestamp)
    np.testing.assert_allclose(again.wTc, trajectory.wTc, atol=1e-12)
    np.testing.assert_array_equal(again.frame_index, [0, 1, 2])
    np.testing.assert_allclose(read_tum_trajectory_file(tmp_path / "t.tum").poses_se3, trajectory.wTc, atol=1e-12)


def test_tum_poses_find_their_frames_by_time(tmp_path):
    trajectory = make_trajectory([0, 1, 4])
    write_tum(trajectory, tmp_path / "t.tum")
    frames = 1311868164.363181 + np.arange(6) / 30 + 0.004
    again = read_tum(tmp_path / "t.tum", frames, max_difference=0.01)
    np.testing.assert_array_equal(again.frame_index, [0, 1, 4])
    np.testing.assert_array_equal(again.timestamp, frames[[0, 1, 4]])
    assert len(read_tum(tmp_path / "t.tum", frames, max_difference=0.001)) == 0


def test_tum_poses_are_sorted_and_repeated_times_dropped(tmp_path):
    lines = ["2 2 0 0 0 0 0 1", "1 1 0 0 0 0 0 1", "2 9 0 0 0 0 0 1"]
    (tmp_path / "t.tum").write_text("\n".join(lines))
    again = read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(again.timestamp, [1, 2])
    np.testing.assert_array_equal(again.positions[:, 0], [1, 2])


def test_kitti_fills_frames_without_a_pose_and_counts_them(tmp_path):
    trajectory = make_trajectory([2, 4, 5])
    assert write_kitti(trajectory, tmp_path / "k.txt", frames=8) == 5
    again = read_kitti(tmp_path / "k.txt")
    assert len(again) == 8
    np.testing.assert_array_equal(again.wTc[[2, 4, 5]], trajectory.wTc)
    np.testing.assert_allclose(again.wTc[0], trajectory.wTc[0], atol=1e-15)
    np.testing.assert_allclose(again.wTc[7], trajectory.wTc[2], atol=1e-15)
    np.testing.assert_allclose(again.positions[3], trajectory.positions[:2].mean(0))
    half = Rotation.from_matrix(trajectory.wTc[0, :3, :3].T @ again.wTc[3, :3, :3]).magnitude()
    whole = Rotation.from_matrix(trajectory.wTc[0, :3, :3].T @ trajectory.wTc[1, :3, :3]).magnitude()
    assert half == pytest.approx(whole / 2)
    assert write_kitti(trajectory, tmp_path / "k.txt") == 0
    assert len(read_kitti(tmp_path / "k.txt")) == 3
    with pytest.raises(DataError, match="frame 5 of 4"):
        write_kitti(trajectory, tmp_path / "k.txt", frames=4)


@pytest.mark.parametrize("text", ["", "1 2 3\n", "0 0 0 0 0 0 0 one\n", "0 0 0 0 0 0 0 nan\n", "0 1 2 3 0 0 0 0\n"])
def test_a_malformed_tum_file_is_a_data_error(tmp_path, text):
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(DataError, match=r"t\.tum"):
        read_tum(tmp_path / "t.tum")
    with pytest.raises(DataError):
        read_kitti(tmp_path / "t.tum")
    with pytest.raises(DataError):
        read_tum(tmp_path / "absent")


def test_ply_has_points_and_camera_centres(tmp_path):
    points = MapPoints(np.array([[1.0, 2, 3], [np.nan, 0, 0]]), np.array([[10, 20, 30], [0, 0, 0]], np.uint8))
    assert write_ply(points, tmp_path / "m.ply", centres=np.array([[4.0, 5, 6]])) == 2
    header, body = (tmp_path / "m.ply").read_bytes().split(b"end_header\n")
    assert header.decode().splitlines() == [
        "ply", "format binary_little_endian 1.0", "element vertex 2", "property float x", "property float y",
        "property float z", "property uchar red", "property uchar green", "property uchar blue",
    ]  # fmt: skip
    vertices = np.frombuffer(body, np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)]))
    np.testing.assert_array_equal(vertices["xyz"], [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(vertices["rgb"], [[10, 20, 30], [255, 128, 0]])


def test_evo_gets_the_poses_and_an_empty_trajectory_is_named():
    trajectory = make_trajectory([0, 3])
    evo = to_evo(trajectory)
    np.testing.assert_array_equal(evo.poses_se3, trajectory.wTc)
    np.testing.assert_array_equal(evo.timestamps, trajectory.timestamp)
    with pytest.raises(DataError, match="no poses"):
        to_evo(Trajectory.empty())


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"file cannot be made \(File exists\)"):
        save_result(make_result(), tmp_path / "file")
    with pytest.raises(DataError, match="file is not a whole SLAM result"):
        load_result(tmp_path / "file")
