"""SLAM results as COLMAP's text model, read back by COLMAP itself where pycolmap is installed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prgbd.core.types import Frame, Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory
from prgbd.io.colmap_model import write_colmap

CAMERA = PinholeCamera(64, 48, 50.0, 51.0, 31.5, 23.25)
KEYFRAMES = 5


def made_up_result() -> SlamResult:
    """Two maps, of three and two keyframes, that see their points where they project; one keyframe sees none."""
    rng = np.random.default_rng(3)
    wTc = np.tile(np.eye(4), (KEYFRAMES, 1, 1))
    wTc[:, :3, :3] = Rotation.from_rotvec(rng.normal(0, 0.1, (KEYFRAMES, 3))).as_matrix()
    wTc[:, :3, 3] = rng.normal(0, 0.3, (KEYFRAMES, 3))
    xyz = np.stack([rng.uniform(-1, 1, 40), rng.uniform(-1, 1, 40), rng.uniform(4, 6, 40)], axis=1)
    rows = []
    for k in (0, 2, 3, 4):
        mine = np.arange(0, 25) if k < 3 else np.arange(25, 39)
        in_camera = (xyz[mine] - wTc[k, :3, 3]) @ wTc[k, :3, :3]
        rows.extend((k, p, *uv) for p, uv in zip(mine, CAMERA.project(in_camera), strict=True))
    table = np.array(rows)[rng.permutation(len(rows))]
    frames = np.array([2, 5, 7, 11, 12])
    return SlamResult(
        camera=CAMERA,
        mode="mono",
        frames=14,
        trajectory=Trajectory(frames, frames / 10, wTc),
        keyframes=Keyframes(frames, frames / 10, wTc, np.array([0, 0, 0, 1, 1], np.int32)),
        points=MapPoints(xyz, rng.integers(0, 256, (40, 3), np.uint8)),
        observations=Observations(
            table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:].astype(np.float32),
            np.zeros(len(table), np.float32),
        ),
        states=["ok"] * 14,
        inliers=np.zeros(14, np.int32),
    )  # fmt: skip


def test_colmap_reads_back_cameras_poses_points_and_tracks(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    result = made_up_result()
    assert write_colmap(result, tmp_path) == 2
    for number, keyframes in enumerate([[0, 1, 2], [3, 4]]):
        model = pycolmap.Reconstruction(str(tmp_path / "sparse" / str(number)))
        (camera,) = model.cameras.values()
        assert camera.model_name == "PINHOLE"
        np.testing.assert_allclose(camera.params, [50, 51, 32, 23.75])
        assert {i.name for i in model.images.values()} == {
            f"{result.keyframes.frame_index[k]:06d}.png" for k in keyframes
        }
        for k in keyframes:
            image = model.images[k + 1]
            cTw = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
            np.testing.assert_allclose(cTw, np.linalg.inv(result.keyframes.wTc[k]), atol=1e-12)
            assert image.num_points3D == (0 if k == 1 else 25 if k < 3 else 14)
        seen = np.unique(result.observations.point[np.isin(result.observations.keyframe, keyframes)])
        assert set(model.points3D) == {p + 1 for p in seen}
        for p, point in model.points3D.items():
            np.testing.assert_allclose(point.xyz, result.points.xyz[p - 1])
            np.testing.assert_array_equal(point.color, result.points.rgb[p - 1])
            assert point.track.length() == 2
            for element in point.track.elements:
                image = model.images[element.image_id]
                keypoint = image.points2D[element.point2D_idx]
                assert keypoint.point3D_id == p
                # In COLMAP's own projection: the pixel convention is right.
                np.testing.assert_allclose(image.project_point(point.xyz), keypoint.xy, atol=2e-4)
        assert model.compute_mean_reprojection_error() < 2e-4


def test_the_text_has_two_lines_per_image_even_without_points(tmp_path):
    write_colmap(made_up_result(), tmp_path)
    lines = (tmp_path / "sparse" / "0" / "images.txt").read_text().split("\n")[1:]
    assert [line.split()[0] for line in lines[0:6:2]] == ["1", "2", "3"]
    assert lines[3] == ""
    assert len(lines[1].split()) == 75
    line = (tmp_path / "sparse" / "0" / "points3D.txt").read_text().splitlines()[1].split()
    assert line[0] == "1"
    assert line[7] == "0.0000"
    assert sorted(line[8::2]) == ["1", "3"]


def test_images_of_the_keyframes_lie_beside_the_model(tmp_path):
    import cv2

    def frame(index: int) -> Frame:
        image = np.zeros((48, 64, 3), np.uint8)
        image[..., 0] = index  # red
        return Frame(index, 0.0, image)

    write_colmap(made_up_result(), tmp_path, frame)
    assert sorted(p.name for p in (tmp_path / "images").iterdir()) == [f"{i:06d}.png" for i in (2, 5, 7, 11, 12)]
    assert cv2.imread(str(tmp_path / "images" / "000007.png"))[0, 0].tolist() == [0, 0, 7]
