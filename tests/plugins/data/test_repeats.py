"""Frames that repeat the one before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data._repeats import repeated, without_repeats
from prgbd.plugins.data.images import ImagesSequence
from prgbd.plugins.data.video import VideoSequence
from tests.plugins.data.filmed import film
from tests.plugins.data.written import write_image

FRAMES = 24


@pytest.fixture(scope="module")
def views() -> list[np.ndarray]:
    """A drive past a textured wall, (48, 64, 3) each."""
    wall = np.random.default_rng(0).integers(0, 255, (12, 60, 3), np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    return [np.ascontiguousarray(wall[:, 3 * i : 3 * i + 64]) for i in range(FRAMES)]


@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [(".mp4", "libx264", {"crf": 33}), (".mp4", "mpeg4", {"qscale": 12}), (".mkv", "ffv1", {"pixels": "bgr0"})],
)
def test_repeats_in_a_video_are_left_out_and_said(views, tmp_path: Path, caplog, suffix, codec, options) -> None:
    path = film(tmp_path / f"doubled{suffix}", (views[i // 2] for i in range(2 * FRAMES)), codec, g=10, **options)
    sequence = VideoSequence(path, fov=60)
    assert f"{FRAMES} of the {2 * FRAMES} frames of" in caplog.text
    assert sequence.remarks == (f"{FRAMES} repeated frames left out",)
    np.testing.assert_allclose(sequence.timestamps, np.arange(0, 2 * FRAMES, 2) / 30, atol=1e-3)
    for i in (0, 7, FRAMES - 1):
        image = sequence.frame(i).image.astype(int)
        assert np.argmin([np.abs(image - view).mean() for view in views]) == i
    assert len(VideoSequence(path, fov=60, repeats="keep")) == 2 * FRAMES
    assert len(VideoSequence(path, fov=60, step=2)) == FRAMES
    assert len(VideoSequence(film(tmp_path / f"once{suffix}", views, codec, g=10, **options), fov=60)) == FRAMES


def test_repeats_in_a_folder_of_images_are_left_out(views, tmp_path: Path) -> None:
    for i in range(2 * FRAMES):
        write_image(tmp_path / f"{i:03}.png", views[2 * i // 5])  # 24 Hz in a file of 60
    sequence = ImagesSequence(tmp_path, fov=60, fps=60)
    kept = [i for i in range(2 * FRAMES) if i == 0 or 2 * i // 5 != 2 * (i - 1) // 5]
    np.testing.assert_allclose(sequence.timestamps, np.array(kept) / 60)
    np.testing.assert_array_equal(sequence.frame(5).image, views[5])
    assert len(ImagesSequence(tmp_path, fov=60, repeats="keep")) == 2 * FRAMES


def test_a_picture_that_differs_in_one_place_is_no_repeat(views) -> None:
    images = [views[i // 2].copy() for i in range(2 * FRAMES)]
    for i, image in enumerate(images):
        image[:6, :6] = 255 * (i % 2)
    stay, said = without_repeats(images.__getitem__, len(images), "the drive", "leave_out")
    assert len(stay) == len(images)
    assert not said


@pytest.mark.parametrize(
    "changes",
    [
        [5.0] * 30,
        [0.0] * 30,
        [0.1, 0.2, 0.1, 0.3] * 8,  # slow motion, or a camera that stands
        [5.0] * 10 + [0.0] * 10 + [5.0] * 10,  # a stop
        [6.0, 4.0, 2.0, 1.0, 0.4, 1.0, 2.0, 4.0] * 4,  # to and fro
        [5.0, np.nan] * 15,  # every second one cannot be read
        [0.0],
    ],
)
def test_other_motions_repeat_nothing(changes) -> None:
    assert not repeated(10 * np.array([np.nan, *changes])).any()


def test_repeats_of_any_rhythm_are_seen() -> None:
    assert repeated(10 * np.array([np.nan, 0.0, 5, 0, 4, 0.3, 5, 0, 0, 0, 6, 0])).sum() == 7


def test_what_is_read_stays_bounded_and_unreadable_frames_stay(views) -> None:
    asked = []

    def read(number: int) -> np.ndarray:
        asked.append(number)
        if number % 3 == 2:
            raise DataError("damaged")
        return views[number % FRAMES]

    stay, said = without_repeats(read, 5000, "the drive", "leave_out")
    assert len(stay) == 5000
    assert not said
    assert len(asked) < 100
    with pytest.raises(ConfigError, match=r"data\.repeats=sometimes"):
        without_repeats(read, 30, "the drive", "sometimes")


@pytest.mark.shared
@pytest.mark.parametrize("family", ["kitti_odometry", "seven_scenes", "tum_rgbd"])
def test_no_frame_of_a_real_recording_is_left_out(shared_data, family) -> None:
    recording = prgbd.make_sequences(family, root=shared_data(family))[0]
    count = min(len(recording), 65)
    stay, _ = without_repeats(lambda i: recording.frame(i).image, count, recording.name, "leave_out")
    assert len(stay) == count


@pytest.mark.parametrize("scene", ["street", "indoor"])
def test_no_frame_of_a_synthetic_world_is_left_out(scene) -> None:
    recording = prgbd.make_data("synthetic", scene=scene, frames=13, width=160, height=96)
    assert len(without_repeats(lambda i: recording.frame(i).image, 13, scene, "leave_out")[0]) == 13
