"""The look at a recording before a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import prgbd
from prgbd import Frame, PinholeCamera, Sequence
from prgbd.core.errors import DataError
from prgbd.core.planar_scene import planar_scene
from prgbd.core.preflight import preflight


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
        ({"change": lambda frames, i: frames[0].image}, "are the same picture"),
        ({"change": lambda frames, i: frames[0].image + np.uint8(i % 2)}, "hardly anything moves"),
        ({"change": lambda frames, i: frames[i].image // 16}, "very dark"),
        ({"change": lambda frames, i: 255 - frames[i].image // 16}, "overexposed"),
        ({"change": lambda frames, i: np.full_like(frames[i].image, 90 + i)}, "too little texture"),
        ({"stamps": np.arange(12) * 1e8}, "unit of the time stamps"),
        ({"stamps": [*np.arange(6) * 0.1, *(5 + np.arange(6) * 0.1)]}, "1 gap in time"),
        ({"camera": PinholeCamera(320, 240, 5000.0, 5000.0, 160, 120)}, "field of view of 4 degrees"),
        ({"camera": PinholeCamera(320, 240, 300.0, 200.0, 160, 120)}, "differ much"),
        ({"camera": PinholeCamera(320, 240, 300.0, 300.0, 20, 120)}, "principal point"),
    ],
)
def test_what_looks_wrong_is_said(options, words) -> None:
    assert words in preflight(Slide(**options)).lines()[1]


def test_a_frame_that_cannot_be_read_is_left_to_the_run() -> None:
    assert "motion 3.0" in preflight(Slide(change=unreadable)).facts
