"""Videos as phones, dash cams and screen recorders make them: every picture and its time, in whatever order."""

from __future__ import annotations

import gc
import multiprocessing
import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from prgbd.core.errors import DataError
from prgbd.plugins.data.video import VideoSequence
from tests.plugins.data.filmed import HEIGHT, WIDTH, coded, film, number_of, replace_box

FRAMES = 40
UNEVEN = np.sort(np.random.default_rng(0).choice(100, FRAMES, replace=False))
CENTISECONDS = Fraction(1, 100)


def even(path: Path, codec: str = "libx264", count: int = FRAMES, size: tuple[int, int] = (WIDTH, HEIGHT), **options):
    film(path, (coded(i, *size) for i in range(count)), codec, **options)
    return np.arange(count), np.arange(count) / 30


def uneven(path: Path, codec: str = "libx264", **options):
    film(path, map(coded, UNEVEN), codec, stamps=[round(1000 * n / 30) for n in UNEVEN], **options)
    return UNEVEN, (UNEVEN - UNEVEN[0]) / 30


def with_edit_list(path: Path):
    """The first 10 frames are cut off as an editor does without encoding anew."""
    film(path, map(coded, range(FRAMES)), g=16, bf=2)
    data = path.read_bytes()
    (scale,) = struct.unpack(">I", data[data.index(b"mdhd") + 16 :][:4])
    with av.open(str(path)) as file:
        begin = min(packet.dts for packet in file.demux(video=0) if packet.dts is not None)
    entry = struct.pack(">IIIiI", 0, 1, 1000, 333 * scale // 1000 - begin, 1 << 16)
    path.write_bytes(replace_box(data, (b"moov", b"trak", b"edts", b"elst"), entry))
    return np.arange(10, FRAMES), np.arange(FRAMES - 10) / 30


def turned(path: Path):
    film(path, (np.rot90(coded(i), -1) for i in range(FRAMES)), rotation=90, bf=2)
    return np.arange(FRAMES), np.arange(FRAMES) / 30


def gif(path: Path):
    film(path, (coded(i)[..., :3] for i in range(12)), "gif", pixels="rgb8", stamps=range(0, 48, 4), base=CENTISECONDS)
    return np.arange(12), np.arange(12) / 25


HDR = {
    "pixels": "yuv420p10le",
    "x265-params": "log-level=none:keyint=12:bframes=3:colorprim=bt2020:transfer=smpte2084:colormatrix=bt2020nc",
}
KINDS = {
    "mp4 with B frames": lambda folder: ("a.mp4", *even(folder / "a.mp4", g=12, bf=3)),
    "portrait": lambda folder: ("a.mp4", *even(folder / "a.mp4", size=(64, 128))),
    "turned": lambda folder: ("a.mov", *turned(folder / "a.mov")),
    "variable rate": lambda folder: ("a.mp4", *uneven(folder / "a.mp4", g=9, bf=2)),
    "variable rate MKV": lambda folder: ("a.mkv", *uneven(folder / "a.mkv", g=9, bf=2)),
    "WebM, VP9": lambda folder: ("a.webm", *uneven(folder / "a.webm", "libvpx-vp9", g=15, **{"cpu-used": 8})),
    "WebM, VP8": lambda folder: (
        "a.webm",
        *even(folder / "a.webm", "libvpx", **{"auto-alt-ref": 1, "lag-in-frames": 9}),
    ),
    "edit list": lambda folder: ("a.mp4", *with_edit_list(folder / "a.mp4")),
    "4K": lambda folder: ("a.mp4", *even(folder / "a.mp4", "mpeg4", count=3, size=(3840, 2160))),
    "grey": lambda folder: ("a.mkv", *even(folder / "a.mkv", "ffv1", pixels="gray")),
    "HDR, 10 bit": lambda folder: ("a.mp4", *even(folder / "a.mp4", "libx265", **HDR)),
    "fragmented": lambda folder: (
        "a.mp4",
        *uneven(folder / "a.mp4", g=8, bf=2, container={"movflags": "frag_keyframe+empty_moov"}),
    ),
    "AVI with B frames": lambda folder: ("a.avi", *even(folder / "a.avi", g=12, bf=2, base=Fraction(1, 30))),
    "AVI of Xvid": lambda folder: ("a.avi", *even(folder / "a.avi", "mpeg4", g=12, bf=2, base=Fraction(1, 30))),
    "MPEG-2 stream": lambda folder: ("a.ts", *even(folder / "a.ts", "mpeg2video", g=12, bf=2, base=Fraction(1, 30))),
    "raw H.264": lambda folder: ("a.h264", *even(folder / "a.h264", g=12, bf=2)),
    "odd size": lambda folder: ("a.mkv", *even(folder / "a.mkv", "ffv1", size=(131, 67), pixels="bgr0")),
    "GIF": lambda folder: ("a.gif", *gif(folder / "a.gif")),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_picture_and_time_is_right_in_any_order(kind: str, tmp_path: Path) -> None:
    name, numbers, times = KINDS[kind](tmp_path)
    rate = 30 if kind.startswith("raw") else None  # such a file says nothing of times
    sequence = VideoSequence(tmp_path / name, fov=60, fps=rate, repeats="keep")
    np.testing.assert_allclose(sequence.timestamps, times, atol=1e-3)
    count = len(numbers)
    at_random = np.random.default_rng(1).integers(0, count, min(count, 16))
    for order in (range(count), range(count - 1, -1, -1), at_random):
        assert [number_of(sequence.frame(int(i)).image) for i in order] == [numbers[i] for i in order]
    part = VideoSequence(tmp_path / name, fov=60, fps=rate, start=count // 2, step=2, repeats="keep")
    np.testing.assert_allclose(part.timestamps, times[count // 2 :: 2], atol=1e-3)
    assert [number_of(frame.image) for frame in part] == list(numbers[count // 2 :: 2])


def test_a_fragmented_file_that_breaks_off_ends_with_its_last_whole_frame(tmp_path, caplog) -> None:
    path = tmp_path / "cut.mp4"
    rng = np.random.default_rng(0)
    noisy = [np.concatenate([coded(i), rng.integers(60, 120, (64, WIDTH, 3), np.uint8)]) for i in range(FRAMES)]
    film(path, noisy, g=8, bf=0, container={"movflags": "frag_keyframe+empty_moov"})
    path.write_bytes(path.read_bytes()[: int(0.62 * path.stat().st_size)])
    sequence = VideoSequence(path, fov=60, repeats="keep")
    assert FRAMES // 2 < len(sequence) < FRAMES
    top = [number_of(frame.image[:HEIGHT]) for frame in sequence]
    assert top == list(range(len(sequence)))
    assert "cannot be decoded and are left out" in caplog.text


def test_a_damaged_frame_in_the_middle_names_itself(tmp_path) -> None:
    path = tmp_path / "damaged.mp4"
    film(path, map(coded, range(FRAMES)), g=8, bf=0)
    with av.open(str(path)) as file:
        packet = [packet for packet in file.demux(video=0) if packet.size][18]
        begin, size = packet.pos, packet.size
    data = bytearray(path.read_bytes())
    data[begin : begin + size] = bytes(size)
    path.write_bytes(data)
    sequence = VideoSequence(path, fov=60, repeats="keep")
    assert len(sequence) == FRAMES
    for _ in range(2):
        with pytest.raises(DataError, match=r"Frame 18 of .*damaged.* data\.stop to 18 or less, or data\.start to 24"):
            sequence.frame(18)
        with pytest.raises(DataError, match="Frame 20 of"):  # it builds upon the damaged one
            sequence.frame(20)
        assert [number_of(sequence.frame(i).image) for i in (17, 24, 3)] == [17, 24, 3]


def test_samples_that_are_not_square_are_made_so_with_their_camera(tmp_path, caplog) -> None:
    path = film(tmp_path / "wide.mp4", map(coded, range(12)), aspect=Fraction(4, 3))
    wide = round(WIDTH * 4 / 3)
    sequence = VideoSequence(path, fov=90)
    assert f"{WIDTH}x{HEIGHT} are scaled to {wide}x{HEIGHT}" in caplog.text
    assert (sequence.camera.width, sequence.camera.height) == (wide, HEIGHT)
    assert (sequence.camera.fx, sequence.camera.fy) == pytest.approx((wide / 2, wide / 2))
    assert [number_of(frame.image) for frame in sequence] == list(range(12))
    stored = {"fx": 90, "fy": 120, "cx": 60, "cy": 30}
    square = {"fx": 120, "fy": 120, "cx": 80, "cy": 30}
    sizes = ({}, {"width": WIDTH, "height": HEIGHT}), ({}, {"width": wide, "height": HEIGHT})
    for values, given in ((stored, sizes[0]), (square, sizes[1])):
        for size in given:
            camera = VideoSequence(path, camera={**values, **size}).camera
            assert (camera.fx, camera.fy, camera.cy) == pytest.approx((120, 120, 30), rel=1e-2)
            assert camera.cx == pytest.approx(80, abs=0.7)
    camera = VideoSequence(path, camera={"fov_degrees": 90}).camera
    assert (camera.fx, camera.fy) == pytest.approx((wide / 2, wide / 2))


def test_one_field_of_an_interlaced_picture_is_kept(tmp_path) -> None:
    combed = [coded(i) for i in range(6)]
    for image in combed:
        image[1::2] = 128
    path = film(tmp_path / "fields.ts", combed, "mpeg2video", flags="+ildct+ilme", base=Fraction(1, 30), qscale=1)
    sequence = VideoSequence(path, fov=60)
    assert [number_of(frame.image) for frame in sequence] == list(range(6))
    assert np.ptp(sequence.frame(0).image[:16, 4].astype(int)) < 30  # no comb


def test_frames_with_the_time_of_another_are_left_out_and_said(tmp_path, caplog) -> None:
    stamps = [40 * i for i in range(30)]
    stamps[9] = stamps[8]
    path = tmp_path / "twice.mkv"
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuvj420p"
        for number, stamp in enumerate(stamps):
            (packet,) = stream.encode(av.VideoFrame.from_ndarray(coded(number), "rgb24").reformat(format="yuvj420p"))
            packet.pts = packet.dts = stamp
            packet.time_base = Fraction(1, 1000)
            file.mux(packet)
    sequence = VideoSequence(path, fov=60, repeats="keep")
    assert "1 frame(s) of" in caplog.text
    expected = [i for i in range(30) if i != 9]
    assert [number_of(sequence.frame(i).image) for i in reversed(range(29))] == expected[::-1]
    np.testing.assert_allclose(sequence.timestamps, [i / 25 for i in expected], atol=1e-3)


def test_a_cover_picture_is_no_video_and_a_single_image_neither(tmp_path) -> None:
    path = tmp_path / "song.mp4"
    with av.open(str(path), "w") as file:
        cover = file.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 640, 480, "yuvj420p"
        cover.disposition = av.stream.Disposition.attached_pic
        drive = file.add_stream("libx264", rate=30)
        drive.width, drive.height, drive.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        file.mux(cover.encode(av.VideoFrame(640, 480, "yuvj420p")))
        for i in range(8):
            file.mux(drive.encode(av.VideoFrame.from_ndarray(coded(i), "rgb24")))
        file.mux(drive.encode(None))
    assert [number_of(frame.image) for frame in VideoSequence(path, fov=60)] == list(range(8))
    for name, codec, pixels in (("one.png", "png", "rgb24"), ("one.jpg", "mjpeg", "yuvj420p")):
        image = film(tmp_path / name, [coded(1)], codec, pixels=pixels)
        with pytest.raises(DataError, match=r"is a single image, no video; take data=images"):
            VideoSequence(image, fov=60)
        disguised = image.rename(tmp_path / f"{name}.mp4")
        with pytest.raises(DataError, match=r"single image"):
            VideoSequence(disguised, fov=60)


def test_a_change_of_size_midway_is_named(tmp_path) -> None:
    path = tmp_path / "two.mjpeg"
    first = film(tmp_path / "first.mjpeg", map(coded, range(4)), "mjpeg", pixels="yuvj420p").read_bytes()
    second = film(tmp_path / "second.mjpeg", [coded(9, 64, 32)], "mjpeg", pixels="yuvj420p").read_bytes()
    path.write_bytes(first + second)
    sequence = VideoSequence(path, fov=60, stop=4)
    assert number_of(sequence.frame(3).image) == 3
    with pytest.raises(DataError, match=r"Frame 4 of .* has another size than the first"):
        VideoSequence(path, fov=60).frame(4)


def test_a_mirrored_video_comes_out_as_players_show_it(tmp_path) -> None:
    path = tmp_path / "mirrored.mp4"
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.set_display_rotation(0, hflip=True)
        for i in range(4):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(coded(i)[:, ::-1]), "rgb24")))
        file.mux(stream.encode(None))
    assert [number_of(frame.image) for frame in VideoSequence(path, fov=60, repeats="keep")] == [0, 1, 2, 3]


def test_a_stream_that_was_tuned_in_late_begins_at_its_first_key_frame(tmp_path, caplog) -> None:
    path = film(tmp_path / "late.ts", map(coded, range(FRAMES)), g=12, bf=2, **{"x264-params": "scenecut=0"})
    data = path.read_bytes()
    path.write_bytes(data[len(data) // 4 // 188 * 188 :])
    sequence = VideoSequence(path, fov=60, repeats="keep")
    assert "The first" in caplog.text
    assert [number_of(frame.image) for frame in sequence] == list(range(FRAMES - len(sequence), FRAMES))
    assert sequence.timestamps[0] == 0


def test_time_stamps_that_begin_anew_are_not_believed(tmp_path, caplog) -> None:
    one, path = tmp_path / "one.ts", tmp_path / "joined.ts"
    film(one, (coded(i % 256) for i in range(150)), "mpeg2video", base=Fraction(1, 30), g=15)
    path.write_bytes(one.read_bytes() * 2)
    sequence = VideoSequence(path, fov=60, repeats="keep")
    assert "does not say when its frames were taken" in caplog.text
    assert [number_of(sequence.frame(i).image) for i in (0, 149, 150, 299, 40)] == [0, 149, 0, 149, 40]
    np.testing.assert_allclose(sequence.timestamps, np.arange(300) / 30, atol=1e-3)


def test_a_file_that_ends_before_it_says_is_read_to_its_end(tmp_path, caplog) -> None:
    path = film(tmp_path / "cut.avi", map(coded, range(FRAMES)), "mjpeg", pixels="yuvj420p", base=Fraction(1, 30))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    sequence = VideoSequence(path, fov=60, repeats="keep")
    assert f"says it has {FRAMES} frames, but ends after" in caplog.text
    assert 0 < len(sequence) < FRAMES
    assert [number_of(frame.image) for frame in sequence] == list(range(len(sequence)))


def test_hidden_files_are_no_videos_and_names_are_unique(tmp_path) -> None:
    for name in ("drive.mkv", "drive.mp4", "other.mp4"):
        film(tmp_path / name, map(coded, range(3)))
    (tmp_path / "._drive.mp4").write_bytes(b"\0\5\26\7")
    found = VideoSequence.available(root=tmp_path)
    assert found == ["drive.mkv", "drive.mp4", "other.mp4"]
    assert [VideoSequence(tmp_path, name, fov=60).name for name in found] == ["drive.mkv", "drive.mp4", "other"]


def _read(sequence: VideoSequence, numbers: list[int], answers) -> None:
    gc.collect()
    answers.put([number_of(sequence.frame(i).image) for i in numbers])


def test_a_forked_process_opens_the_file_for_itself(tmp_path) -> None:
    sequence = VideoSequence(film(tmp_path / "a.mp4", map(coded, range(FRAMES)), g=8), fov=60, repeats="keep")
    sequence.frame(20)
    garbage = VideoSequence(tmp_path / "a.mp4", fov=60, repeats="keep")
    garbage.frame(20)
    garbage.itself = garbage
    del garbage  # freed where the collector comes to it, as in the child
    fork = multiprocessing.get_context("fork")
    answers = fork.Queue()
    child = fork.Process(target=_read, args=(sequence, [21, 3, 39], answers))
    child.start()
    assert [number_of(sequence.frame(i).image) for i in (21, 22, 4)] == [21, 22, 4]
    assert answers.get(timeout=20) == [21, 3, 39]
    child.join(20)
    assert child.exitcode == 0
