"""The plug-in for video files."""

from __future__ import annotations

import pickle
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data.video import VideoSequence
from tests.contracts import SequenceContract
from tests.plugins.data.filmed import replace_box
from tests.plugins.data.written import cut

FRAMES = 90


def shade(image: np.ndarray) -> float:
    """The grey that carries the frame's number, free of compression's noise."""
    return float(image[4:-4, 4:-4].mean())


@pytest.fixture(scope="module", params=["clip.mp4", "clip.avi"])
def clip(request, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("video") / request.param
    code = cv2.VideoWriter_fourcc(*("mp4v" if path.suffix == ".mp4" else "MJPG"))
    writer = cv2.VideoWriter(str(path), code, 25.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write videos")
    for i in range(FRAMES):
        writer.write(np.full((48, 64, 3), (2 * i + 20, 2 * i + 20, 2 * i + 20), np.uint8))
    writer.release()
    return path


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, clip: Path) -> VideoSequence:
        return VideoSequence(clip, fov=60)


def test_frames_in_order_and_at_random(clip: Path) -> None:
    sequence = prgbd.make_data("video", root=clip, fov=90)
    assert (sequence.name, len(sequence), sequence.fps) == ("clip", FRAMES, pytest.approx(25))
    assert sequence.camera.fx == pytest.approx(32)
    forwards = [shade(sequence.frame(i).image) for i in range(FRAMES)]
    np.testing.assert_allclose(forwards, 2 * np.arange(FRAMES) + 20, atol=6)
    assert np.all(np.diff(forwards) > 0)
    for i in (80, 3, 4, 60, 0, 89, 30):
        assert shade(sequence.frame(i).image) == pytest.approx(forwards[i], abs=0.01)


def test_a_range_and_another_frame_rate(clip: Path) -> None:
    sequence = VideoSequence(clip, fov=90, fps=50, start=10, stop=40, step=10)
    assert len(sequence) == 3
    np.testing.assert_allclose(sequence.timestamps, [0.2, 0.4, 0.6])
    assert shade(sequence.frame(2).image) == pytest.approx(2 * 30 + 20, abs=6)


def test_channels_are_rgb(tmp_path: Path) -> None:
    path = tmp_path / "red.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    for _ in range(3):
        writer.write(np.full((48, 64, 3), (0, 0, 250), np.uint8))
    writer.release()
    red, _, blue = VideoSequence(path, fov=60).frame(1).image.reshape(-1, 3).mean(axis=0)
    assert red > 200 > 60 > blue


def test_a_copy_opens_the_file_for_itself(clip: Path) -> None:
    sequence = VideoSequence(clip, fov=90)
    sequence.frame(5)
    copy = pickle.loads(pickle.dumps(sequence))
    np.testing.assert_array_equal(copy.frame(7).image, sequence.frame(7).image)


def test_distortion_is_removed(clip: Path, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text("camera: {fx: 40, fy: 40, cx: 31.5, cy: 23.5, distortion: [0.3, 0, 0, 0]}")
    sequence = VideoSequence(clip, camera=path)
    assert sequence.camera.distortion == ()
    assert sequence.frame(60).image[0, 0].max() < 60 < sequence.frame(60).image[24, 32].min()


def test_a_folder_of_videos(clip: Path) -> None:
    assert VideoSequence.available(root=clip) == [None]
    assert VideoSequence.available(root=clip.parent) == [clip.name]
    assert VideoSequence(clip.parent, clip.name, fov=60).name == "clip"


def test_bad_input_is_named(clip: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="There is no video file"):
        VideoSequence(tmp_path / "absent.mp4", fov=60)
    with pytest.raises(DataError, match="has no videos"):
        VideoSequence(tmp_path, fov=60)
    with pytest.raises(ConfigError, match="is not known"):
        VideoSequence(clip)
    with pytest.raises(ConfigError, match="frame rate"):
        VideoSequence(clip, fov=60, fps=-1)
    with pytest.raises(ConfigError, match="leaves none"):
        VideoSequence(clip, fov=60, start=500)
    text = tmp_path / "text.mp4"
    text.write_text("no video at all")
    with pytest.raises(DataError, match=r"text\.mp4"):
        VideoSequence(text, fov=60)
    copy = tmp_path / clip.name
    copy.write_bytes(clip.read_bytes())
    cut(copy, 0.5)
    # Half an MP4 lacks its index; half an AVI still has its first frames.
    if clip.suffix == ".mp4":
        with pytest.raises(DataError, match=r"clip\.mp4 is no video .* or is truncated"):
            VideoSequence(copy, fov=60)
    else:
        half = VideoSequence(copy, fov=60)
        assert 0 < len(half) < FRAMES
        assert shade(half.frame(len(half) - 1).image) == pytest.approx(2 * (len(half) - 1) + 20, abs=6)


def test_a_frame_that_cannot_be_decoded_is_named(clip: Path) -> None:
    sequence = VideoSequence(clip, fov=60)
    with pytest.raises(DataError, match=rf"Frame {FRAMES + 200} of .*clip"):
        sequence._reader.read(FRAMES + 200)
    assert shade(sequence.frame(3).image) == pytest.approx(26, abs=6)


def test_a_video_is_shrunk_with_its_camera(clip: Path) -> None:
    camera = {"fx": 40, "fy": 40, "cx": 31.5, "cy": 23.5, "distortion": [0.3, 0, 0, 0]}
    sequence = VideoSequence(clip, camera=camera, width=32)
    assert (sequence.camera.width, sequence.camera.height, sequence.camera.fx) == (32, 24, 20)
    assert sequence.frame(3).image.shape == (24, 32, 3)
    for width in (0, 65, True):
        with pytest.raises(ConfigError, match=r"data\.width"):
            VideoSequence(clip, fov=60, width=width)


@pytest.fixture
def phone(tmp_path: Path) -> Path:
    """An MP4 whose frames are told apart by their grey, 64x48 pixels, 25 Hz."""
    path = tmp_path / "phone.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write videos")
    for i in range(FRAMES):
        image = np.full((48, 64, 3), 2 * i + 20, np.uint8)
        image[:8, :] = 255 if i == 0 else image[:8, :]
        writer.write(image)
    writer.release()
    return path


def test_times_of_a_variable_frame_rate_are_the_frames_own(phone: Path) -> None:
    data = phone.read_bytes()
    at = data.index(b"mdhd")
    (scale,) = struct.unpack(">I", data[at + 16 : at + 20])
    slow, fast = scale // 10, scale // 50
    table = struct.pack(">IIIIII", 0, 2, 20, slow, FRAMES - 20, fast)
    phone.write_bytes(replace_box(data, (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"), table))
    sequence = VideoSequence(phone, fov=60)
    expected = np.cumsum([0.0, *[0.1] * 20, *[0.02] * (FRAMES - 21)])
    np.testing.assert_allclose(sequence.timestamps, expected, atol=1e-3)
    for i in (80, 3, 4, 60, 10, 89, 30):
        assert shade(sequence.frame(i).image[8:]) == pytest.approx(2 * i + 20, abs=6)
    assert VideoSequence(phone, fov=60, fps=25).timestamps[1] == pytest.approx(0.04)


def test_a_turned_phone_video_comes_out_upright(phone: Path) -> None:
    data = bytearray(phone.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    turned = (0, 1 << 16, 0, -(1 << 16), 0, 0, 48 << 16, 0, 1 << 30)  # by 90 degrees, as phones note it
    data[at : at + 36] = struct.pack(">9i", *turned)
    phone.write_bytes(data)
    sequence = VideoSequence(phone, fov=60)
    assert (sequence.camera.width, sequence.camera.height) == (48, 64)
    image = sequence.frame(0).image
    assert image.shape == (64, 48, 3)
    assert image[:, -6:].mean() > 200 > image[:, :6].mean()
    assert sequence.frame(70).image.shape == (64, 48, 3)  # sought, not read in order


def test_a_video_without_frames_is_named(tmp_path: Path) -> None:
    path = tmp_path / "empty.mp4"
    cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (64, 48)).release()
    with pytest.raises(DataError, match=r"empty\.mp4"):
        VideoSequence(path, fov=60)


def test_frames_behind_damage_are_left_out_or_named(phone: Path) -> None:
    data = bytearray(phone.read_bytes())
    begin = data.index(b"mdat") + 4
    end = data.index(b"moov") - 4
    tail = begin + (end - begin) // 2
    data[tail:end] = bytes(end - tail)
    phone.write_bytes(data)
    sequence = VideoSequence(phone, fov=60)
    assert 0 < len(sequence) <= FRAMES
    assert shade(sequence.frame(5).image[8:]) == pytest.approx(30, abs=6)


def test_the_camera_file_beside_a_video_is_taken(clip: Path) -> None:
    beside = clip.with_suffix(".camera.yaml")
    beside.write_text("camera: {fx: 50, fy: 50, cx: 31.5, cy: 23.5}")
    try:
        assert VideoSequence(clip).camera.fx == 50
        assert VideoSequence(clip, fov=90).camera.fx == pytest.approx(32)
    finally:
        beside.unlink()


def test_without_calibration_three_mends_are_named(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("prgbd.plugins.data._camera.can_estimate", lambda: False)
    with pytest.raises(ConfigError, match=r"is not known; set data\.fov .* or data\.camera .*prgbd\[colmap\]"):
        VideoSequence(clip)
