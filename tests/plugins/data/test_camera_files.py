"""Camera files of every program, and calibrations that contradict the image or themselves."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from prgbd.core.errors import DataError
from prgbd.core.types import PinholeCamera
from prgbd.core.undistortion import Undistorter
from prgbd.plugins.data._camera import camera_from_values, make_camera
from prgbd.plugins.data._lens import FisheyeCamera

CAMERA = PinholeCamera(640, 480, 500, 510, 318, 242, (0.1, -0.2, 0.001, -0.002, 0.05))
FISHEYE = FisheyeCamera(640, 480, 300, 310, 318, 242, (0.06, -0.03, 0.005, -0.002))
ROS = """
image_width: 640
image_height: 480
camera_name: left
camera_matrix: {rows: 3, cols: 3, data: [FX, 0, 318, 0, FY, 242, 0, 0, 1]}
distortion_model: MODEL
distortion_coefficients: {rows: 1, cols: 5, data: LENS}
"""
KALIBR = """
cam0:
  camera_model: pinhole
  distortion_coeffs: LENS
  distortion_model: MODEL
  intrinsics: [FX, FY, 318, 242]
  resolution: [640, 480]
  T_cam_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
cam1: {camera_model: pinhole, intrinsics: [1, 1, 1, 1], resolution: [640, 480]}
"""
EUROC = """
sensor_type: camera
camera_model: pinhole
intrinsics: [FX, FY, 318, 242]
resolution: [640, 480]
distortion_model: MODEL
distortion_coefficients: LENS
"""
MESSAGE = """
height: 480
width: 640
distortion_model: MODEL
D: LENS
K: [FX, 0.0, 318.0, 0.0, FY, 242.0, 0.0, 0.0, 1.0]
"""
OWN = "camera: {fx: FX, fy: FY, cx: 318, cy: 242, model: MODEL, distortion: LENS}"
FORMATS = {
    "ros": (ROS, "plumb_bob", "equidistant"),
    "kalibr": (KALIBR, "radtan", "equidistant"),
    "euroc": (EUROC, "radial-tangential", "equidistant"),
    "message": (MESSAGE, "plumb_bob", "fisheye"),
    "own": (OWN, "opencv", "fisheye"),
}


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["opencv", "fisheye"])
@pytest.mark.parametrize("kind", FORMATS)
def test_files_of_other_programs(tmp_path: Path, kind: str, camera: PinholeCamera) -> None:
    text, *models = FORMATS[kind]
    values = {"FX": camera.fx, "FY": camera.fy, "MODEL": models[camera is FISHEYE], "LENS": list(camera.distortion)}
    for word, value in values.items():
        text = text.replace(word, str(value))
    file = tmp_path / "camera.yaml"
    file.write_text(text)
    found = make_camera(file, None, 640, 480, tmp_path)
    assert found == camera
    assert type(found) is type(camera)
    with pytest.raises(DataError, match=r"640x480 images, but the images are|outside the 320x240 images"):
        make_camera(file, None, 320, 240, tmp_path)


@pytest.mark.parametrize("name", ["camera.yaml", "camera.xml"])
def test_files_of_opencv(tmp_path: Path, name: str) -> None:
    storage = cv2.FileStorage(str(tmp_path / name), cv2.FileStorage_WRITE)
    storage.write("calibration_time", "Thu Jan  1 2026")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", CAMERA.K)
    storage.write("distortion_coefficients", np.array(CAMERA.distortion)[:, None])
    storage.release()
    assert make_camera(tmp_path / name, None, 640, 480, tmp_path) == CAMERA


def test_settings_of_orb_slam(tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    lens = "".join(
        f"Camera.{key}: {value}\n" for key, value in zip(("k1", "k2", "p1", "p2", "k3"), CAMERA.distortion, strict=True)
    )
    given = "".join(f"Camera.{key}: {getattr(CAMERA, key):.1f}\n" for key in ("fx", "fy", "cx", "cy"))
    file.write_text(f'%YAML:1.0\n---\nCamera.type: "PinHole"\n{given}{lens}Camera.fps: 30.0\nCamera.width: 640\n')
    assert make_camera(file, None, 640, 480, tmp_path) == CAMERA
    text = file.read_text().replace("Camera.", "Camera1.").replace("Camera1.type", "Camera.type")
    file.write_text(text.replace("PinHole", "KannalaBrandt8"))
    assert isinstance(make_camera(file, None, 640, 480, tmp_path), FisheyeCamera)


PLAIN = {"fx": 500, "fy": 500, "cx": 319.5, "cy": 239.5}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": True}, "fx in it is True, which is no number"),
        ({"fx": "nan"}, "is nan, which is not finite"),
        ({"fx": [500]}, "which is no number"),
        ({"fx": None}, "which is no number"),
        ({"width": 640.5}, "no whole number"),
        ({"cx": 212.8, "cy": 159.5}, r"images of about 427x320 pixels, but .*640x480; multiply .* by 1\.5"),
        ({"cx": 425, "cy": 319}, "images of about 851x639 pixels"),
        ({"distortion": [0.06, -0.03, 0.05, -0.02]}, r"p1=0\.05, p2=-0\.02, which are too large .*'model: fisheye'"),
        ({"distortion": [-0.5, 0.1, 0.4, 0, 0]}, "too large for a lens"),
        ({"distortion": [-1.5, 0.0, 0.0, 0.0]}, "folds the picture back at .*'model: fisheye'"),
        ({"distortion": [-0.1, -2.0, 0.0, 0.0, 0.1]}, "folds the picture back .* check the order"),
        ({"distortion": [9.0, 9.0, 0.0, 0.0, 9.0]}, "moves the corner"),
        ({"distortion": [0, 0, 0, 0, 0, -4, 0, 0]}, "folds the picture|moves the corner"),
        ({"distortion": [1e300, 1e300, 0, 0]}, "folds the picture|moves the corner"),
        ({"distortion": [-4.0, 0.1, 0.1, 0.1], "model": "fisheye"}, "folds the picture"),
        ({"distortion": [0.1] * 5, "model": "fisheye"}, "has 5 numbers; the model 'fisheye' has 4"),
        ({"distortion": [0.1] * 4, "model": "pinhole"}, "has 4 numbers; the model 'pinhole' has 0"),
        ({"distortion": "abcd"}, "must be a list"),
        ({"distortion": {"k1": 0.1}}, "must be a list"),
        ({"model": "omni"}, "must be one of pinhole, opencv, fisheye"),
        ({"model": ["fisheye"]}, "must be one of"),
    ],
)
def test_a_calibration_that_contradicts_the_image_or_itself_is_refused(change: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        camera_from_values(PLAIN | change, "it", 640, 480)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"distortion": [0.01, 0.02, -0.0128, 0.003]}, "unusually large; if these are k1 to k4"),
        ({"fx": 240, "fy": 240, "distortion": [0.003, 0.0007, -0.002, 0.0002]}, "hardly bends straight lines; if"),
        ({"distortion": [-0.6, 0.0, 0.0, 0.0, 0.0]}, "outermost corners"),
    ],
)
def test_a_doubtful_lens_is_said(change: dict, words: str, caplog) -> None:
    camera_from_values(PLAIN | change, "it", 640, 480)
    assert words in caplog.text
    caplog.clear()
    assert camera_from_values({**PLAIN, "width": 640, "height": 480, "cx": 213, "cy": 160}, "it", 640, 480)
    assert not caplog.messages


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (KALIBR.replace("pinhole", "omni"), "model 'omni'; calibrate with 'pinhole'"),
        (ROS.replace("MODEL", "thin_plate"), "distortion model 'thin_plate'; known are"),
        (ROS.replace("FX, 0, ", ""), "camera matrix of 7 numbers"),
        ('%YAML:1.0\n---\nCamera.type: "Omni"\nCamera.fx: 3\n', "type 'Omni'"),
        ("%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n  rows: 3\n", "readable file of OpenCV|camera matrix"),
        ("<?xml version='1.0'?><opencv_storage><a>", "readable file of OpenCV"),
        ("a: 2001-99-99", "no readable YAML|unknown entry"),
        ("[" * 3000, "no readable YAML"),
    ],
)
def test_a_wrong_file_of_another_program_is_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(text)
    with pytest.raises(DataError, match=message):
        make_camera(file, None, 640, 480, tmp_path)


def test_a_fisheye_comes_out_as_a_pinhole_camera_sees() -> None:
    ray = np.array([[[0.35, -0.3, 1.0]]])
    seen = cv2.fisheye.projectPoints(ray, np.zeros(3), np.zeros(3), FISHEYE.K, np.array(FISHEYE.distortion))[0].ravel()
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    image = np.repeat((255 * np.exp(-((u - seen[0]) ** 2 + (v - seen[1]) ** 2) / 18)).astype(np.uint8)[..., None], 3, 2)
    out = Undistorter(FISHEYE).image(image)[..., 0].astype(float)
    found = np.array([(out * u).sum(), (out * v).sum()]) / out.sum()
    np.testing.assert_allclose(found, FISHEYE.undistorted().project(ray[0])[0], atol=0.5)
    assert FISHEYE.undistorted() == PinholeCamera(640, 480, 300, 310, 318, 242)
    assert type(FISHEYE.resized(320, 240)) is FisheyeCamera
