"""The look at a recording before a run."""

from __future__ import annotations

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import prgbd
from prgbd import Frame, PinholeCamera, Sequence
from prgbd.core.errors import DataError
from prgbd.core.testing.planar_scene import planar_scene
from prgbd.tools.preflight import preflight


class Slide(Sequence):
    """A camera that slides along a textured wall, 3 pixels a frame."""

    def __init__(self, change=None, stamps=None, camera=None) -> None:
        self.name = "slide"
        self.frames = planar_scene(12)
        self.camera = camera or PinholeCamera.from_fov(320, 240, 60.0)
        self.timestamps = np.arange(12) * 0.1 if stamps is None else np.asarray(stamps, float)
        self.change = change or (lambda frames, index: frames[index].image)

    def frame(self, index: int) -> Frame:
        image = np.asarray(self.change(self.frames, index), np.uint8)
        return replace(self.frames[index], image=image)


def turned(frames, index):
    """The first image as a camera (field of view 60 degrees) sees it that turns by 1.5 degrees a frame."""
    K = PinholeCamera.from_fov(320, 240, 60.0).K
    R = Rotation.from_euler("yx", [1.5 * index, 0.7 * index], degrees=True).as_matrix()
    return cv2.warpPerspective(wide(), K @ R @ np.linalg.inv(K) @ SHIFT, (320, 240), flags=cv2.INTER_LINEAR)


SHIFT = np.array([[1.0, 0, -240], [0, 1, -180], [0, 0, 1]])


@functools.cache
def wide():
    """A picture around that of the camera, so that it sees something wherever it turns."""
    return planar_scene(1, 800, 600)[0].image


def compressed(image, index):
    """Other noise in every frame, as a codec leaves it."""
    return np.clip(image + np.random.default_rng(index).normal(0, 0.7, image.shape), 0, 255)


def unreadable(frames, index):
    if index == 5:
        raise DataError("cut off")
    return frames[index].image


def test_a_sound_recording_has_nothing_unusual_and_its_motion_is_measured() -> None:
    found = preflight(Slide())
    assert found.warnings == ()
    assert found.lines()[1] == "nothing unusual"
    for words in ("12 frames at 10.0 Hz", "field of view 60 degrees", "motion 3.0 pixels a frame"):
        assert words in found.facts


def test_a_recording_of_the_field_has_nothing_unusual() -> None:
    assert preflight(prgbd.make_data("synthetic", sequence="street-0", frames=20)).warnings == ()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"change": lambda frames, i: frames[0].image}, "the picture is frozen"),
        ({"change": lambda frames, i: frames[i // 2].image}, "10 of 19 neighbouring frames are the same picture"),
        ({"change": lambda frames, i: compressed(frames[i // 2].image, i)}, "neighbouring frames are the same picture"),
        ({"change": lambda frames, i: 0 * frames[0].image}, "the images are black"),
        (
            {"change": lambda frames, i: frames[8 if i == 9 else i].image},
            "2 of 19 neighbouring frames are the same picture: some",
        ),
        ({"change": turned}, "it only turns, which shows no depth; the sensor's is needed (slam.mode=rgbd)"),
        ({"change": turned, "camera": PinholeCamera.from_fov(320, 240, 32.2)}, "fits a focal length of about 277"),
        ({"change": turned, "camera": PinholeCamera.from_fov(320, 240, 98.2)}, "fits a focal length of about 277"),
        ({"change": lambda frames, i: frames[0].image + np.uint8(i % 2)}, "hardly anything moves"),
        ({"change": lambda frames, i: frames[i].image // 16}, "very dark"),
        ({"change": lambda frames, i: 255 - frames[i].image // 16}, "overexposed"),
        ({"change": lambda frames, i: np.full_like(frames[i].image, 90 + i)}, "too little texture"),
        ({"stamps": np.arange(12) * 1e8}, "unit of the time stamps"),
        ({"stamps": [*np.arange(6) * 0.1, *(5 + np.arange(6) * 0.1)]}, "1 gap in time"),
        (
            {"camera": PinholeCamera(320, 240, 5000.0, 5000.0, 160, 120)},
            "field of view of 3.67 degrees is unlikely; check fx",
        ),
        ({"camera": PinholeCamera.from_fov(320, 240, 1.2)}, "that a field of view is given in degrees"),
        ({"camera": PinholeCamera.from_fov(160, 107, 60)}, "160x107 are too small for 1000 features"),
        ({"camera": PinholeCamera.from_fov(3840, 2160, 60)}, "images of 3840x2160 pixels take long"),
        ({"camera": PinholeCamera(320, 240, 300.0, 200.0, 160, 120)}, "differ much"),
        ({"camera": PinholeCamera(320, 240, 300.0, 300.0, 20, 120)}, "principal point"),
    ],
)
def test_what_looks_wrong_is_said(options, words) -> None:
    assert words in preflight(Slide(**options)).lines()[1]


def test_a_focal_length_that_is_a_little_wrong_is_said_where_the_camera_turns() -> None:
    sequence = prgbd.make_data("synthetic", sequence="indoor-0", frames=40)
    true = sequence.camera
    sequence.camera = replace(true, fx=0.84 * true.fx, fy=0.84 * true.fy)
    (words,) = preflight(sequence).warnings
    assert float(words.split("about ")[1].split()[0]) == pytest.approx(true.fx, rel=0.08)


def test_a_camera_that_only_turns_is_moved_or_given_a_network_where_it_has_no_sensor() -> None:
    slide = Slide(change=turned)
    slide.frames = [frame.with_depth(None) for frame in slide.frames]
    (warning,) = preflight(slide).warnings
    assert warning.endswith("it only turns, which shows no depth; move it sideways, or give depth=ID")


def test_a_frame_that_cannot_be_read_is_left_to_the_run() -> None:
    assert "motion 3.0" in preflight(Slide(change=unreadable)).facts
