"""Recordings in the layout of the EuRoC MAV data set."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import prgbd
from prgbd.core.errors import DataError
from prgbd.core.types import PinholeCamera
from prgbd.plugins.data._rectification import Rectification
from prgbd.plugins.data.euroc import EurocSequence
from tests.contracts import SequenceContract
from tests.plugins.data.written import picture, write_image, write_picture

START = 1403636579763555584  # nanoseconds, as in MH_01_easy
STEP = 50_000_000
LENS = (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)
# The published calibration of the data set's two cameras.
PUBLISHED = (
    ((458.654, 457.296, 367.215, 248.375), LENS),
    ((457.587, 456.134, 379.999, 255.238), (-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05)),
)
BODY_FROM_CAM0 = np.array(
    [
        [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
        [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
        [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
        [0, 0, 0, 1],
    ]
)
BODY_FROM_CAM1 = np.array(
    [
        [0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556],
        [0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024],
        [-0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038],
        [0, 0, 0, 1],
    ]
)


def sensor(matrix: np.ndarray, lens: tuple[float, ...] = LENS, model: str = "radial-tangential") -> str:
    return (
        "# General sensor definitions.\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
        f"  data: {matrix.ravel().tolist()}\nrate_hz: 20\nresolution: [64, 48]\ncamera_model: pinhole\n"
        f"intrinsics: [50.0, 49.0, 31.0, 24.0] #fu, fv, cu, cv\ndistortion_model: {model}\n"
        f"distortion_coefficients: {list(lens)}\n"
    )


def body(seconds: float) -> np.ndarray:
    """The body's pose: it turns and goes forward evenly, so that interpolated poses are exact."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0, 0.5 * seconds, 0]).as_matrix()
    pose[:3, 3] = [1 + 2 * seconds, -3, 0.5 * seconds]
    return pose


def write(folder: Path, frames: int = 4, cam1: bool = True) -> Path:
    """Write a recording and return its folder."""
    cameras = {"cam0": BODY_FROM_CAM0} | ({"cam1": BODY_FROM_CAM1} if cam1 else {})
    for name, matrix in cameras.items():
        home = folder / "mav0" / name
        stamps = [START + STEP * i for i in range(frames)]
        for i, stamp in enumerate(stamps):
            write_picture(home / "data" / f"{stamp}.png", i + (10 if name == "cam1" else 0))
        lines = "".join(f"{stamp},{stamp}.png\r\n" for stamp in stamps)
        (home / "data.csv").write_text(f"#timestamp [ns],filename\r\n{lines}", newline="")
        (home / "sensor.yaml").write_text(sensor(matrix))
    rows = []
    for i in range(-2, 10 * frames):  # every 5 ms, beside the images by 2 ms
        pose = body(5e-3 * i + 2e-3)
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        rows.append([START + 5_000_000 * i + 2_000_000, *pose[:3, 3], w, x, y, z, *[0.0] * 9])
    truth = folder / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    truth.parent.mkdir(parents=True)
    truth.write_text("#timestamp, p_RS_R_x [m], ...\n" + "\n".join(",".join(map(str, row)) for row in rows))
    return folder


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, tmp_path: Path) -> EurocSequence:
        return EurocSequence(write(tmp_path / "MH_01_easy"))


def test_times_camera_and_poses_of_one_camera(tmp_path):
    sequence = prgbd.make_data("euroc", root=write(tmp_path / "MH_01_easy"), stereo=False)
    assert (sequence.name, len(sequence), sequence.baseline) == ("MH_01_easy", 4, None)
    np.testing.assert_allclose(sequence.timestamps - START * 1e-9, 0.05 * np.arange(4), atol=1e-6)
    assert sequence.camera == PinholeCamera(64, 48, 50.0, 49.0, 31.0, 24.0)
    frame = sequence.frame(2)
    assert frame.right is None
    assert frame.depth is None
    assert abs(int(frame.image[24, 31, 0]) - 20) <= 1  # the middle stays where it is
    for i in range(4):
        true = body(0.05 * i) @ BODY_FROM_CAM0
        np.testing.assert_allclose(sequence.poses[i], true, atol=2e-6)


def test_the_pair_is_rectified_and_its_poses_turn_with_it(tmp_path):
    sequence = EurocSequence(write(tmp_path / "MH_01_easy"))
    assert sequence.baseline == pytest.approx(0.110, abs=5e-4)
    assert sequence.camera.fx == sequence.camera.fy
    frame = sequence.frame(1)
    assert frame.image[20:28, 28:36, 0].mean() == pytest.approx(10, abs=1)
    assert frame.right[20:28, 28:36, 0].mean() == pytest.approx(110, abs=1)
    # The rectified camera's x axis is the way from the left to the right one.
    way = (body(0.05) @ BODY_FROM_CAM1)[:3, 3] - (body(0.05) @ BODY_FROM_CAM0)[:3, 3]
    np.testing.assert_allclose(sequence.poses[1][:3, 0], way / np.linalg.norm(way), atol=1e-5)
    np.testing.assert_allclose(sequence.poses[1][:3, 3], (body(0.05) @ BODY_FROM_CAM0)[:3, 3], atol=1e-5)


def test_the_published_calibration_gives_the_published_rectified_camera(tmp_path):
    left, right = (PinholeCamera(752, 480, *intrinsics, lens) for intrinsics, lens in PUBLISHED)
    pair = Rectification(left, right, np.linalg.solve(BODY_FROM_CAM1, BODY_FROM_CAM0), tmp_path)
    # f and bf of ORB-SLAM2's Examples/Stereo/EuRoC.yaml; f is chosen by OpenCV, of another version there.
    assert pair.camera.fx == pytest.approx(435.2046959714599, rel=3e-3)
    assert pair.baseline == pytest.approx(47.90639384423901 / 435.2046959714599, rel=1e-9)


def test_a_point_lies_in_one_row_of_both_images_at_its_disparity(tmp_path):
    left, right = (PinholeCamera(752, 480, *intrinsics, lens) for intrinsics, lens in PUBLISHED)
    rTl = np.linalg.solve(BODY_FROM_CAM1, BODY_FROM_CAM0)
    pair = Rectification(left, right, rTl, tmp_path)
    point = np.array([0.3, -0.2, 2.0])  # in the rectified left camera
    seen = []
    for camera, mTl, rectifier in ((left, np.eye(4), pair.left), (right, rTl, pair.right)):
        image = np.zeros((480, 752, 3), np.uint8)
        u, v = distorted(camera, (mTl @ pair.lTn @ np.append(point, 1))[:3])
        yy, xx = np.mgrid[:480, :752]
        image[...] = (255 * np.exp(-((xx - u) ** 2 + (yy - v) ** 2) / 18))[..., None].astype(np.uint8)
        weights = rectifier.image(image)[..., 0].astype(float)
        seen.append([(weights * xx).sum() / weights.sum(), (weights * yy).sum() / weights.sum()])
    np.testing.assert_allclose(seen[0], pair.camera.project(point[None])[0], atol=0.1)
    assert seen[0][1] == pytest.approx(seen[1][1], abs=0.1)
    assert seen[0][0] - seen[1][0] == pytest.approx(pair.camera.fx * pair.baseline / 2.0, abs=0.1)


def distorted(camera: PinholeCamera, point: np.ndarray) -> tuple[float, float]:
    """Where a camera with radial-tangential distortion sees a point, by the formulas."""
    x, y = point[:2] / point[2]
    k1, k2, p1, p2 = camera.distortion
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2
    x, y = (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )
    return camera.fx * x + camera.cx, camera.fy * y + camera.cy


def test_right_images_find_the_left_ones_by_time(tmp_path):
    folder = write(tmp_path / "MH_01_easy")
    listing = folder / "mav0" / "cam1" / "data.csv"
    lines = listing.read_text().splitlines()
    listing.write_text("\n".join([lines[0], *lines[2:]]))  # the first one is lost
    sequence = EurocSequence(folder)
    assert sequence.frame(0).right is None
    assert sequence.frame(1).right[24, 32, 0] == pytest.approx(110, abs=1)


def test_names_in_a_folder_of_several(tmp_path):
    for name in ("machine_hall/MH_01_easy", "machine_hall/MH_02_easy", "vicon_room1/V1_01_easy"):
        write(tmp_path / name, cam1=False)
    assert EurocSequence.available(root=tmp_path) == ["MH_01_easy", "MH_02_easy", "V1_01_easy"]
    assert EurocSequence(tmp_path, "V1_01").name == "V1_01_easy"
    with pytest.raises(DataError, match="there are MH_01_easy, MH_02_easy, V1_01_easy"):
        EurocSequence(tmp_path, "MH")
    with pytest.raises(DataError, match="holds 3 sequences"):
        EurocSequence(tmp_path)


def test_without_truth_there_are_no_poses(tmp_path):
    folder = write(tmp_path / "MH_01_easy")
    shutil.rmtree(folder / "mav0" / "state_groundtruth_estimate0")
    assert EurocSequence(folder).poses is None


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda mav: (mav / "cam0/data.csv").unlink(), "There is no file .*data.csv"),
        (lambda mav: (mav / "cam0/data.csv").write_text("#timestamp,filename\n"), "lists no images"),
        (lambda mav: (mav / "cam0/data.csv").write_text("a,b.png\n"), "Line 1 .* is not a time stamp and a file"),
        (lambda mav: (mav / "cam0/sensor.yaml").unlink(), "There is no file .*sensor.yaml"),
        (lambda mav: (mav / "cam0/sensor.yaml").write_text(sensor(2 * np.eye(4))), "no rigid transform"),
        (lambda mav: (mav / "cam1/sensor.yaml").write_text(sensor(np.eye(3))), "no T_BS with 16 numbers"),
        (lambda mav: (mav / "cam1/sensor.yaml").write_text(sensor(np.eye(4))), "does not stand beside cam0"),
        (lambda mav: swap(mav), "must be the right one"),
        (
            lambda mav: (mav / "cam1/sensor.yaml").write_text(sensor(BODY_FROM_CAM1, (0.01,) * 4, "equidistant")),
            "fisheye .* data.stereo=false",
        ),
        (lambda mav: write_image(mav / f"cam0/data/{START}.png", picture(0, 32, 24)), "64x48 images, but"),
        (lambda mav: (mav / "state_groundtruth_estimate0/data.csv").write_text("1,2,3\n"), "not 17 numbers"),
        (lambda mav: shutil.rmtree(mav / "cam0"), "There is no file .*cam0/data.csv"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path, spoil, words):
    folder = write(tmp_path / "MH_01_easy")
    spoil(folder / "mav0")
    with pytest.raises(DataError, match=words):
        EurocSequence(folder)


def swap(mav: Path) -> None:
    (mav / "cam0").rename(mav / "was0")
    (mav / "cam1").rename(mav / "cam0")
    (mav / "was0").rename(mav / "cam1")


def test_a_folder_without_recordings_names_what_is_to_be_unpacked(tmp_path):
    (tmp_path / "MH_01_easy.zip").write_bytes(b"PK")
    with pytest.raises(DataError, match=r"unpack MH_01_easy.zip"):
        EurocSequence(tmp_path)
