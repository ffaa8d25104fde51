"""A camera that is faked by a video file, which is played at its own rate."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError, DiskError
from prgbd.plugins.data import _live_recording
from prgbd.plugins.data._live_source import LiveSource, _SourceClock
from prgbd.plugins.data.camera import CameraSequence
from tests.contracts import SequenceContract
from tests.plugins.data.filmed import coded, film, number_of
from tests.plugins.data.written import write_picture

RATE = 30


def play(path: Path, frames: int, **options) -> Path:
    return film(path, (coded(i) for i in range(frames)), **options)


def numbers(sequence: CameraSequence) -> list[int]:
    return [number_of(frame.image) for frame in sequence]


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, tmp_path: Path) -> CameraSequence:
        return CameraSequence(play(tmp_path / "a.mp4", 6), tmp_path / "camera", fov=60)


def test_a_file_is_played_at_its_own_rate_and_kept(tmp_path, caplog):
    path = play(tmp_path / "a.mp4", 30, bf=2)
    begin, now = time.monotonic(), time.time()
    sequence = prgbd.make_data("camera", root=path, folder=tmp_path / "camera", fov=60, lossless=True)
    took = time.monotonic() - begin
    assert 29 / RATE <= took < 29 / RATE + 3
    assert (sequence.name, numbers(sequence)) == ("camera", list(range(30)))
    np.testing.assert_allclose(np.diff(sequence.timestamps), 1 / RATE, atol=2e-3)
    assert 0 <= sequence.timestamps[0] - now < 3
    assert "Ctrl-C ends the recording" in caplog.text
    assert "Recorded 30 frames" in caplog.text
    assert "0 dropped" in caplog.text
    assert sequence.remarks == (f"recorded from {path}, 0 dropped",)
    with av.open(str(path)) as file:
        for frame, kept in zip(file.decode(video=0), sequence, strict=True):
            np.testing.assert_array_equal(frame.to_ndarray(format="rgb24"), kept.image)


def test_what_lies_in_the_folder_is_read_again_without_a_camera(tmp_path, caplog):
    path = play(tmp_path / "a.mp4", 6)
    first = CameraSequence(path, tmp_path / "camera", fov=60)
    path.unlink()
    again = CameraSequence(path, tmp_path / "camera", fov=60, start=1, stop=4)
    np.testing.assert_array_equal(again.timestamps, first.timestamps[1:4])
    np.testing.assert_array_equal(again.frame(0).image, first.frame(1).image)
    assert "holds a recording already" in caplog.text
    assert again.remarks == first.remarks


def test_pictures_that_cannot_be_written_in_time_are_dropped_and_counted(tmp_path, caplog, monkeypatch):
    write = _live_recording._write

    def slowly(*arguments) -> None:
        time.sleep(0.1)
        write(*arguments)

    monkeypatch.setattr(_live_recording, "_write", slowly)
    monkeypatch.setattr(_live_recording, "WAITING", 2)
    sequence = CameraSequence(play(tmp_path / "a.mp4", 30), tmp_path / "camera", fov=60)
    note = _live_recording.read_note(tmp_path / "camera")
    assert note.dropped > 5
    assert len(sequence) == note.frames == 30 - note.dropped
    assert numbers(sequence) == sorted(set(numbers(sequence)))
    np.testing.assert_allclose(  # who is left keeps the time at which it was taken
        sequence.timestamps - sequence.timestamps[0], np.array(numbers(sequence)) / RATE, atol=2e-3
    )
    assert f"{note.dropped} dropped" in caplog.text
    assert f"too slow for {note.dropped} of 30 pictures" in caplog.text


def test_ctrl_c_keeps_everything_and_the_run_goes_on(tmp_path, caplog):
    path = play(tmp_path / "a.mp4", 250)
    handler = signal.getsignal(signal.SIGINT)

    def press() -> None:
        while len(list((tmp_path / "camera").glob("[0-9]*"))) < 6:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    sequence = CameraSequence(path, tmp_path / "camera", fov=60)
    thread.join()
    assert 6 <= len(sequence) < 200
    assert numbers(sequence) == list(range(len(sequence)))
    assert "it ended by Ctrl-C" in caplog.text
    assert signal.getsignal(signal.SIGINT) is handler
    assert all(not name.startswith(".") for name in os.listdir(tmp_path / "camera"))


def test_limits_end_it(tmp_path):
    path = play(tmp_path / "a.mp4", 250)
    assert numbers(CameraSequence(path, tmp_path / "a", frames=5, fov=60)) == [0, 1, 2, 3, 4]
    assert 1 <= len(CameraSequence(path, tmp_path / "b", seconds=0.4, fov=60)) < 100
    assert _live_recording.read_note(tmp_path / "b").ended == "after 0.4 s"


def test_a_recording_that_was_killed_is_read_as_far_as_it_came(tmp_path):
    for i in range(3):
        write_picture(tmp_path / "camera" / f"{1_700_000_000_000_000_000 + i * 10**8}.png", i)
    (tmp_path / "camera" / ".1700000000500000000.png").write_bytes(b"half")
    sequence = CameraSequence(0, tmp_path / "camera", fov=60)
    assert len(sequence) == 3
    assert sequence.fps == pytest.approx(10)
    assert sequence.remarks == ("a recording that broke off",)


def test_damaged_pictures_are_counted_and_the_rest_is_kept(tmp_path):
    path = play(tmp_path / "a.avi", 12, codec="mjpeg", pixels="yuvj420p", base=Fraction(1, 30))
    data = bytearray(path.read_bytes())
    at = [i for i in range(len(data)) if data[i : i + 2] == b"\xff\xd8"][4]
    data[at : at + 600] = bytes(600)
    path.write_bytes(data)
    sequence = CameraSequence(path, tmp_path / "camera", fov=60)
    note = _live_recording.read_note(tmp_path / "camera")
    assert note.damaged == 1
    assert numbers(sequence) == [i for i in range(12) if i != 4]


def test_a_stream_from_the_network_is_taken_until_it_ends(tmp_path):
    data = play(tmp_path / "a.ts", 20, codec="mpeg2video", g=5, base=Fraction(1, 30)).read_bytes()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def send() -> None:
            connection, _ = server.accept()
            with connection:
                for part in np.array_split(np.frombuffer(data, np.uint8), 20):
                    connection.sendall(part.tobytes())
                    time.sleep(1 / RATE)

        thread = threading.Thread(target=send)
        thread.start()
        root = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        sequence = CameraSequence(root, tmp_path / "camera", fov=60, options={"probesize": 4096})
        thread.join()
    assert numbers(sequence) == list(range(20))
    np.testing.assert_allclose(np.diff(sequence.timestamps), 1 / RATE, atol=2e-3)
    assert sequence.remarks == (f"recorded from {root}, 0 dropped",)


def test_a_stream_whose_clock_is_set_keeps_ascending():
    clock = _SourceClock()
    stamps = [clock.stamp(100.0), clock.stamp(100.1)]
    time.sleep(0.15)
    stamps += [clock.stamp(seconds) for seconds in (3.0, 3.1)]
    time.sleep(0.15)
    stamps += [clock.stamp(seconds) for seconds in (None, 3.2)]
    assert np.all(np.diff(stamps) > 0)
    assert stamps[1] - stamps[0] == 10**8
    assert stamps[3] - stamps[2] == 10**8
    assert abs(clock.stamp(1e6) - time.time_ns()) < 10**9  # a jump ahead
    assert clock.until(1e6 + 0.5) == pytest.approx(0.5, abs=0.1)
    assert clock.until(2e6) == 0


def test_names_and_passwords_of_an_address_are_not_repeated(tmp_path):
    with pytest.raises(DataError) as caught:
        LiveSource("rtsp://me:secret@127.0.0.1:9/cam", {})
    assert "secret" not in str(caught.value)
    assert "rtsp://127.0.0.1:9/cam cannot be opened" in str(caught.value)
    assert "check the address" in str(caught.value)


@pytest.mark.parametrize(
    ("root", "options", "error", "words"),
    [
        (97, {}, DataError, "There is no camera or video /dev/video97 .cameras of this computer: .*set data.root to"),
        ("no.mp4", {}, DataError, "There is no camera or video no.mp4"),
        (".", {}, DataError, "neither a camera nor a file; for a folder of images take data=images"),
        ("text.mp4", {}, DataError, "text.mp4 cannot be opened .*check the address or the file"),
        ("sound.wav", {}, DataError, "sound.wav gives no pictures"),
        ("a.mp4", {"sequence": "x"}, DataError, "leave data.sequences empty"),
        ("a.mp4", {"frames": 2, "start": 2}, ConfigError, "leaves none of the 2 frames"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path, monkeypatch, root, options, error, words):
    monkeypatch.chdir(tmp_path)
    play(tmp_path / "a.mp4", 3)
    (tmp_path / "text.mp4").write_text("no video")
    with av.open("sound.wav", "w") as file:
        stream = file.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        frame.sample_rate = 8000
        file.mux(stream.encode(frame))
    with pytest.raises(error, match=words):
        CameraSequence(root, tmp_path / "camera", fov=60, **options)


def test_folders_that_cannot_hold_a_recording(tmp_path):
    path = play(tmp_path / "a.mp4", 3)
    write_picture(tmp_path / "photos" / "holiday.png", 1)
    with pytest.raises(DataError, match=r"holiday.png, which is no picture of data=camera"):
        CameraSequence(path, tmp_path / "photos", fov=60)
    with pytest.raises(DiskError, match="cannot be written"):
        CameraSequence(path, path / "camera", fov=60)


def test_nothing_is_left_where_nothing_came(tmp_path, monkeypatch):
    path = play(tmp_path / "a.mp4", 3)
    monkeypatch.setattr(cv2, "imencode", None)  # never reached
    monkeypatch.setattr(LiveSource, "_frames", lambda self, stop: iter(()))
    with pytest.raises(DataError, match=r"No picture came from .*a.mp4 \(it ended with the source\)"):
        CameraSequence(path, tmp_path / "camera", fov=60)
    assert not (tmp_path / "camera").exists()
