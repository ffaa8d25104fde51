"""Bags of ROS 1 and ROS 2 as recordings."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import PinholeCamera
from prgbd.plugins.data._bag_messages import image_of
from prgbd.plugins.data.rgbd import RgbdSequence
from prgbd.plugins.data.rosbag import RosbagSequence
from tests.contracts import SequenceContract
from tests.plugins.data.bags import START, Entry, Ros, png
from tests.plugins.data.written import HEIGHT, WIDTH, cut, picture, write_depth, write_image

K = (50.0, 0, 31.0, 0, 49.0, 24.0, 0, 0, 1)
STEP = 100_000_000
KINDS = [(1, "a.bag", "SQLITE3"), (2, "a", "SQLITE3"), (2, "a", "MCAP")]
RAW, COLOUR_INFO = "/cam/image_raw", "/cam/camera_info"
each_version = pytest.mark.parametrize(("version", "name", "storage"), KINDS)


def entries(ros: Ros, frames: int = 4, topic: str = RAW, info: bool = True, encoding: str = "rgb8") -> list[Entry]:
    """Pictures with their camera; they are recorded 3 ms after they were taken."""
    found: list[Entry] = []
    for i in range(frames):
        stamp = START + i * STEP
        pixels = picture(i) if encoding == "rgb8" else picture(i)[..., ::-1]
        found.append((topic, stamp + 3_000_000, ros.image(stamp, pixels, encoding)))
        if info:
            beside = f"{topic.rpartition('/')[0]}/camera_info"
            found.append((beside, stamp + 3_000_000, ros.info(stamp, (WIDTH, HEIGHT), K)))
    return found


def depth_entries(ros: Ros, frames: int = 4, frame: str = "camera", topic: str = "/cam/depth") -> list[Entry]:
    return [
        (topic, START + i * STEP + 9_000_000, ros.image(START + i * STEP + 5_000_000, levels(i), "16UC1", frame))
        for i in range(frames)
    ]


def levels(number: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH), 1000 * (number + 1), np.uint16)


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, tmp_path: Path) -> RosbagSequence:
        return RosbagSequence(Ros(2).write(tmp_path / "walk", entries(Ros(2)) + depth_entries(Ros(2))))


@each_version
def test_images_times_camera_and_depth(tmp_path, version, name, storage):
    ros = Ros(version)
    path = ros.write(tmp_path / name, entries(ros) + depth_entries(ros, 3), storage)
    sequence = prgbd.make_data("rosbag", root=path)
    assert (sequence.name, len(sequence)) == ("a", 4)
    assert sequence.camera == PinholeCamera(WIDTH, HEIGHT, 50.0, 49.0, 31.0, 24.0)
    np.testing.assert_array_equal(sequence.timestamps, (START + STEP * np.arange(4)) / 1e9)
    for i in (3, 0, 1, 2, 0):  # in any order
        frame = sequence.frame(i)
        np.testing.assert_array_equal(frame.image, picture(i))
        assert frame.depth[5, 5] == (pytest.approx(i + 1) if i < 3 else 0)
    assert any("images of /cam/image_raw" in remark for remark in sequence.remarks)


@pytest.fixture(scope="module")
def walk(tmp_path_factory) -> tuple[RgbdSequence, list[tuple[int, np.ndarray, np.ndarray]], np.ndarray]:
    """A rendered walk as files: the recording, its times, pictures and levels of depth, and SLAM's trajectory."""
    world = prgbd.make_data("synthetic", scene="indoor", frames=12, width=256, height=192)
    folder = tmp_path_factory.mktemp("walk")
    (folder / "camera.yaml").write_text(f"camera: {world.camera.to_dict()}")
    frames = []
    for i in range(len(world)):
        millimetres = np.round(1000 * world.depth(i)).astype(np.uint16)
        frames.append((START + i * STEP, world.frame(i).image, millimetres))
        write_image(folder / "rgb" / f"{START + i * STEP}.png", world.frame(i).image)
        write_depth(folder / "depth" / f"{START + i * STEP}.png", millimetres)
    sequence = RgbdSequence(folder)
    return sequence, frames, trajectory(sequence)


def trajectory(sequence: Any) -> np.ndarray:
    """SLAM's poses on the sensor's depth, (N, 4, 4)."""
    with prgbd.make_slam("orb_gtsam") as system:
        system.reset(sequence.camera, "rgbd", baseline=0.08, fps=sequence.fps, seed=0)
        for frame in sequence:
            system.track(frame)
        return system.finish().trajectory.wTc


@each_version
def test_slam_finds_the_same_trajectory_in_a_bag_as_in_its_images(tmp_path, walk, version, name, storage):
    images, frames, expected = walk
    ros, camera = Ros(version), images.camera
    found: list[Entry] = []
    for stamp, image, millimetres in frames:
        found.append(("/rgb/image_rect_color", stamp, ros.image(stamp, image[..., ::-1], "bgr8", pad=4)))
        found.append(("/depth/image", stamp, ros.image(stamp, millimetres, "16UC1")))
        size, P = (camera.width, camera.height), np.hstack([camera.K, np.zeros((3, 1))])
        found.append(("/rgb/camera_info", stamp, ros.info(stamp, size, camera.K.ravel(), P=P.ravel())))
    bag = RosbagSequence(ros.write(tmp_path / name, found, storage))
    assert bag.camera == camera
    np.testing.assert_array_equal(bag.timestamps, images.timestamps)
    for i in range(len(images)):
        np.testing.assert_array_equal(bag.frame(i).image, images.frame(i).image)
        np.testing.assert_array_equal(bag.frame(i).depth, images.frame(i).depth)
    assert len(expected) == len(frames)
    np.testing.assert_array_equal(trajectory(bag), expected)


@each_version
def test_a_file_of_its_own_and_names_in_a_folder(tmp_path, version, name, storage):
    ros = Ros(version)
    ros.write(tmp_path / "bags" / name, entries(ros), storage)
    ros.write(tmp_path / "bags" / f"b{name[1:]}", entries(ros, 3), storage)
    assert RosbagSequence.available(root=tmp_path / "bags") == [name, f"b{name[1:]}"]
    assert len(RosbagSequence(tmp_path / "bags", f"b{name[1:]}")) == 3
    if version == 2:  # without metadata.yaml, as where the recorder was killed
        (file,) = (p for p in (tmp_path / "bags" / name).iterdir() if p.suffix in (".db3", ".mcap"))
        np.testing.assert_array_equal(RosbagSequence(file).frame(2).image, picture(2))


def test_a_part_of_the_frames_and_a_copy_in_another_process(tmp_path):
    ros = Ros(1)
    sequence = RosbagSequence(ros.write(tmp_path / "a.bag", entries(ros, 9) + depth_entries(ros, 9)), start=2, step=3)
    assert len(sequence) == 3
    np.testing.assert_array_equal(sequence.frame(1).image, picture(5))
    copy = pickle.loads(pickle.dumps(sequence))
    np.testing.assert_array_equal(copy.frame(2).image, picture(8))
    assert copy.frame(2).depth[0, 0] == 9


def bayer(image: np.ndarray) -> np.ndarray:
    """The mosaic RGGB of an image of one colour."""
    mosaic = np.repeat(image[:, :, 1:2], 1, axis=2)[..., 0].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = image[::2, ::2, 0], image[1::2, 1::2, 2]
    return mosaic


PLAIN = np.tile(np.array([[[200, 120, 40]]], np.uint8), (HEIGHT, WIDTH, 1))
GREY = np.full((HEIGHT, WIDTH), 77, np.uint8)
ALPHA = np.full((HEIGHT, WIDTH, 1), 255, np.uint8)


@pytest.mark.parametrize(
    ("pixels", "encoding", "expected"),
    [
        (PLAIN, "rgb8", PLAIN),
        (PLAIN[..., ::-1], "bgr8", PLAIN),
        (np.concatenate([PLAIN, ALPHA], 2), "rgba8", PLAIN),
        (np.concatenate([PLAIN[..., ::-1], ALPHA], 2), "bgra8", PLAIN),
        (GREY, "mono8", np.repeat(GREY[..., None], 3, 2)),
        (bayer(PLAIN), "bayer_rggb8", PLAIN),
        (bayer(PLAIN[..., ::-1]), "bayer_bggr8", PLAIN),
        ((GREY.astype(np.uint16) << 8), "mono16", np.repeat(GREY[..., None].astype(np.uint16) << 8, 3, 2)),
        ((GREY.astype(">u2") << 8).astype(">u2"), "mono16", np.repeat(GREY[..., None].astype(np.uint16) << 8, 3, 2)),
        ((PLAIN.astype(np.uint16) << 8), "rgb16", PLAIN.astype(np.uint16) << 8),
    ],
)
@pytest.mark.parametrize("pad", [0, 6])
def test_encodings(pixels, encoding, expected, pad):
    found = image_of(Ros(1).image(START, pixels, encoding, pad=pad), "it")
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


def test_yuv_is_close_to_its_colour():
    r, g, b = PLAIN[0, 0] / 255
    y = 16 + 65.481 * r + 128.553 * g + 24.966 * b  # ITU-R BT.601
    u, v = 128 - 37.797 * r - 74.203 * g + 112 * b, 128 + 112 * r - 93.786 * g - 18.214 * b
    pairs = np.tile(np.round([u, y, v, y]).astype(np.uint8), HEIGHT * WIDTH // 2).reshape(HEIGHT, WIDTH, 2)
    for encoding, values in (("yuv422", pairs), ("yuv422_yuy2", pairs[..., ::-1])):
        found = image_of(Ros(2).image(START, values, encoding), "it")
        np.testing.assert_allclose(found, PLAIN, atol=2)


def test_grey_of_twelve_bits_becomes_eight_by_one_factor(tmp_path):
    ros = Ros(1)
    ramp = np.tile(np.linspace(0, 4000, WIDTH).astype(np.uint16), (HEIGHT, 1))
    images = [(RAW, START + i * STEP, ros.image(START + i * STEP, ramp, "mono16")) for i in range(3)]
    sequence = RosbagSequence(ros.write(tmp_path / "a.bag", images), fov=60)
    np.testing.assert_array_equal(sequence.frame(0).image[0, :, 0], ramp[0] // 16)
    assert any("12 bits" in remark for remark in sequence.remarks)


@each_version
def test_compressed_images_and_depth(tmp_path, version, name, storage):
    ros = Ros(version)
    found = []
    for i in range(3):
        stamp = START + i * STEP
        found.append(
            ("/cam/image_raw/compressed", stamp, ros.compressed(stamp, png(picture(i)), "rgb8; png compressed"))
        )
        depth = bytes(12) + png(levels(i))
        found.append(("/cam/depth/compressedDepth", stamp, ros.compressed(stamp, depth, "16UC1; compressedDepth png")))
    sequence = RosbagSequence(ros.write(tmp_path / name, found, storage), fov=60)
    np.testing.assert_array_equal(sequence.frame(1).image, picture(1))
    assert sequence.frame(1).depth[3, 3] == 2


def test_depth_in_metres(tmp_path):
    ros = Ros(2)
    depth = np.full((HEIGHT, WIDTH), 1.25, np.float32)
    depth[0] = np.nan
    found = [("/depth", START + i * STEP, ros.image(START + i * STEP, depth, "32FC1")) for i in range(3)]
    frame = RosbagSequence(ros.write(tmp_path / "a", entries(ros, 3) + found)).frame(0)
    assert (frame.depth[0, 0], frame.depth[1, 0]) == (0, 1.25)


def test_depth_of_another_camera_is_taken_only_where_it_is_named(tmp_path):
    ros = Ros(2)
    path = ros.write(tmp_path / "a", entries(ros) + depth_entries(ros, frame="depth_camera"))
    sequence = RosbagSequence(path)
    assert sequence.frame(0).depth is None
    assert any("left out, for it is in the frame 'depth_camera'" in remark for remark in sequence.remarks)
    assert RosbagSequence(path, depth="/cam/depth").frame(0).depth[0, 0] == 1


def test_raw_images_are_taken_where_they_are_compressed_too(tmp_path):
    ros = Ros(1)
    twins = [(f"{RAW}/compressed", t, ros.compressed(t, png(picture(9)), "png")) for t in (START, START + STEP)]
    sequence = RosbagSequence(ros.write(tmp_path / "a.bag", entries(ros) + twins))
    np.testing.assert_array_equal(sequence.frame(0).image, picture(0))


def test_several_topics_are_listed_and_one_is_chosen(tmp_path):
    ros = Ros(1)
    both = entries(ros, topic="/left/image_raw") + entries(ros, 2, topic="/right/image_raw")
    path = ros.write(tmp_path / "a.bag", both)
    with pytest.raises(DataError, match=r"has 2 topics that data.image can be.*/left/image_raw.*/right/image_raw"):
        RosbagSequence(path)
    assert len(RosbagSequence(path, image="/right/image_raw")) == 2
    with pytest.raises(DataError, match=r"no topic '/middle' for data.image; there are .*/left/image_raw"):
        RosbagSequence(path, image="/middle")
    with pytest.raises(DataError, match=r"no topic '/x' for data.depth"):
        RosbagSequence(path, image="/left/image_raw", depth="/x")


def test_lenses_of_the_bag_are_those_of_a_camera_file(tmp_path):
    ros = Ros(2)
    lens = (-0.2, 0.05, 0.001, -0.0005, 0.0, 0.0, 0.0, 0.0)
    infos = [(COLOUR_INFO, START, ros.info(START, (WIDTH, HEIGHT), K, lens, model="rational_polynomial"))]
    sequence = RosbagSequence(ros.write(tmp_path / "a", entries(ros, info=False) + infos))
    values = {"width": WIDTH, "height": HEIGHT, "fx": 50, "fy": 49, "cx": 31, "cy": 24, "distortion": list(lens)}
    for i in range(4):
        write_image(tmp_path / "images" / f"{i}.png", picture(i))
    same = prgbd.make_data("images", root=tmp_path / "images", camera=values)
    assert sequence.camera == same.camera
    np.testing.assert_array_equal(sequence.frame(1).image, same.frame(1).image)
    assert not np.array_equal(sequence.frame(1).image, picture(1))


def test_rectified_images_have_the_projection_matrix(tmp_path):
    ros = Ros(1)
    P = (60.0, 0, 32.0, 0, 0, 60.0, 23.0, 0, 0, 0, 1, 0)
    infos = [(COLOUR_INFO, START, ros.info(START, (WIDTH, HEIGHT), K, (-0.2, 0.05, 0, 0, 0), P))]
    sequence = RosbagSequence(ros.write(tmp_path / "a.bag", entries(ros, topic="/cam/image_rect", info=False) + infos))
    assert sequence.camera == PinholeCamera(WIDTH, HEIGHT, 60.0, 60.0, 32.0, 23.0)
    np.testing.assert_array_equal(sequence.frame(1).image, picture(1))


def test_what_the_user_gives_of_the_camera_comes_before_the_bag(tmp_path):
    ros = Ros(2)
    path = ros.write(tmp_path / "a", entries(ros))
    assert RosbagSequence(path, fov=90).camera.fx == pytest.approx(WIDTH / 2)


def test_headers_without_times_leave_those_of_the_recording(tmp_path):
    ros = Ros(2)
    found = [(RAW, START + i * STEP, ros.image(0, picture(i), "rgb8")) for i in range(3)]
    sequence = RosbagSequence(ros.write(tmp_path / "a", found), fov=60)
    np.testing.assert_array_equal(sequence.timestamps, (START + STEP * np.arange(3)) / 1e9)
    assert any("headers without times" in remark for remark in sequence.remarks)


def test_frames_are_in_the_order_of_their_headers_and_none_comes_twice(tmp_path, caplog):
    ros = Ros(1)
    stamps = (1, 0, 2, 2, 3)
    found = [(RAW, START + i * STEP, ros.image(START + s * STEP, picture(s), "rgb8")) for i, s in enumerate(stamps)]
    sequence = RosbagSequence(ros.write(tmp_path / "a.bag", found), fov=60)
    assert [int(sequence.frame(i).image[0, 0, 0]) for i in range(4)] == [0, 10, 20, 30]
    assert len(sequence) == 4
    assert "1 message(s) of /cam/image_raw" in caplog.text


def test_messages_of_one_time_of_recording_are_told_apart(tmp_path):
    ros = Ros(2)
    found = [(RAW, START, ros.image(START + i * STEP, picture(i), "rgb8")) for i in range(4)]
    sequence = RosbagSequence(ros.write(tmp_path / "a", found), fov=60)
    assert [int(sequence.frame(i).image[0, 0, 0]) for i in (3, 1, 0, 2)] == [30, 10, 0, 20]


@each_version
def test_a_damaged_message_is_named_when_the_run_comes_to_it(tmp_path, version, name, storage):
    ros = Ros(version)
    data = png(picture(1))
    found = [
        (f"{RAW}/compressed", START + i * STEP, ros.compressed(START + i * STEP, d, "png"))
        for i, d in enumerate([png(picture(0)), data[: len(data) // 2], png(picture(2))])
    ]
    sequence = RosbagSequence(ros.write(tmp_path / name, found, storage), fov=60)
    with pytest.raises(DataError, match=r"Message 1 of /cam/image_raw/compressed in .* is truncated or no image"):
        sequence.frame(1)
    np.testing.assert_array_equal(sequence.frame(2).image, picture(2))


def test_a_message_shorter_than_its_image_is_one_sentence(tmp_path):
    ros = Ros(1)
    found = entries(ros)
    found[2][2].data = found[2][2].data[:100]
    sequence = RosbagSequence(ros.write(tmp_path / "a.bag", found))
    with pytest.raises(DataError, match=r"has 100 bytes, too few for 64x48 pixels of rgb8; .*data.start and data.stop"):
        sequence.frame(1)


@each_version
def test_a_bag_that_breaks_off_is_one_sentence(tmp_path, version, name, storage):
    ros = Ros(version)
    path = ros.write(tmp_path / name, entries(ros), storage)
    cut(path if version == 1 else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap")))
    with pytest.raises(DataError, match=r"is truncated, damaged or no bag .*; copy it anew, or repair it with"):
        RosbagSequence(path)


def spoilt_info(ros: Ros, **changes: Any) -> list[Entry]:
    message = ros.info(START, (WIDTH, HEIGHT), K)
    for key, value in changes.items():
        setattr(message, key, value)
    return [*entries(ros, info=False), (COLOUR_INFO, START, message)]


@pytest.mark.parametrize(
    ("found", "options", "error", "words"),
    [
        ([(COLOUR_INFO, START, Ros(1).info(START, (64, 48), K))], {}, DataError, "no topic of images .*camera_info"),
        (spoilt_info(Ros(1), width=128), {}, DataError, r"/cam/camera_info in .* is the camera of 128x48 images"),
        (spoilt_info(Ros(1), distortion_model="odd"), {}, DataError, "the distortion model 'odd'"),
        (entries(Ros(1), encoding="nv99"), {}, DataError, "Message 0 of .* has the encoding 'nv99'; known are mono8"),
        (entries(Ros(1)), {"start": 4}, ConfigError, "leaves none of the 4 frames"),
        (entries(Ros(1)), {"sequence": "b"}, DataError, "no sequence 'b' in the single bag"),
        (
            [*entries(Ros(1)), ("/depth", START + 10**12, Ros(1).image(START + 10**12, levels(1), "16UC1"))],
            {},
            DataError,
            "The times of the depth images of .* do not meet",
        ),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path, found, options, error, words):
    path = Ros(1).write(tmp_path / "a.bag", found)
    with pytest.raises(error, match=words):
        RosbagSequence(path, **options)


def test_roots_that_are_no_bags(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "drive.mp4").write_bytes(b"")
    (tmp_path / "text.bag").write_text("no bag")
    for root, words in (
        ("empty", "holds no bags"),
        ("drive.mp4", "for a video take data=video"),
        ("absent.bag", "There is no file"),
        ("text.bag", "text.bag is truncated, damaged or no bag"),
    ):
        with pytest.raises(DataError, match=words):
            RosbagSequence(tmp_path / root)
