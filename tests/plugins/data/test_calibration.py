"""The camera of a recording that nobody calibrated."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import prgbd
from prgbd.core.errors import SlamError
from prgbd.core.testing.planar_scene import planar_scene
from prgbd.core.types import PinholeCamera
from prgbd.plugins.data.calibration import Estimate, estimate_camera, pieces, step_of
from prgbd.tools.__main__ import main


def test_pieces_are_spread_and_fit() -> None:
    assert pieces(40, 2) == [range(0, 40, 2)]
    assert pieces(60, 2) == [range(6, 53, 2)]
    for piece in (found := pieces(1000, 5)):
        assert len(piece) == 24
        assert 0 <= piece[0] <= piece[-1] < 1000
    assert (len(found), found[0][0]) == (3, 0)


def test_images_are_as_far_apart_as_the_motion_asks() -> None:
    wall = planar_scene(60)
    assert step_of(lambda i: wall[i].image, 60) == 4  # 3 pixels a frame
    assert step_of(lambda i: np.zeros((48, 64, 3), np.uint8), 60) == 2


def test_pieces_that_differ_are_said() -> None:
    estimate = Estimate(PinholeCamera(640, 480, 500, 500, 320, 240), (460.0, 500.0, 510.0), 70)
    assert "3 pieces (460, 500, 510); the pieces differ" in estimate.words()


def test_an_estimate_is_not_sold_as_a_calibration() -> None:
    camera = PinholeCamera(640, 480, 500, 500, 320, 240)
    assert "may be off by 10 % or more" in Estimate(camera, (500.0,), 20).words()
    assert "that they agree is no proof" in Estimate(camera, (495.0, 500.0), 40).words()


def test_a_recording_that_stands_still_tells_nothing() -> None:
    pytest.importorskip("pycolmap")
    image = planar_scene(1)[0].image
    with pytest.raises(SlamError, match=r"could not estimate the camera of still.*data\.fov"):
        estimate_camera(lambda i: image, 6, "still")


def test_a_video_is_calibrated_once_and_then_taken(tmp_path, capsys, monkeypatch) -> None:
    pytest.importorskip("pycolmap")
    monkeypatch.setitem(prgbd.plugins.data.calibration.OPTIONS, "threads", 1)
    world = prgbd.make_data("synthetic", sequence="indoor-0", frames=24, width=320, height=240)
    path = tmp_path / "room.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (320, 240))
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write videos")
    for i in range(len(world)):
        writer.write(world.frame(i).image[..., ::-1])
    writer.release()
    sequence = prgbd.make_data("video", root=str(path))  # nothing given: estimated, and kept beside the video
    assert sequence.camera.fx == pytest.approx(world.camera.fx, rel=0.1)
    kept = tmp_path / "room.camera.yaml"
    assert "Estimated by COLMAP from room.avi" in kept.read_text()
    before = kept.stat().st_mtime_ns
    assert prgbd.make_data("video", root=str(path)).camera == sequence.camera
    assert kept.stat().st_mtime_ns == before
    kept.unlink()
    assert main(["calibrate", str(path), "--out", str(tmp_path / "mine.yaml")]) == 0
    assert "data.camera=" in capsys.readouterr().out
    assert prgbd.make_data("video", root=str(path), camera=tmp_path / "mine.yaml").camera == sequence.camera


def test_nothing_to_calibrate_is_one_sentence(tmp_path, capsys) -> None:
    assert main(["calibrate", str(tmp_path / "absent.mp4")]) == 2
    assert "There is no video file" in capsys.readouterr().err
