"""The passive checks and the conformance checks catch what they promise to catch."""

from dataclasses import replace

import numpy as np
import pytest

from prgbd import (
    Frame,
    GeometricSLAM,
    Keyframes,
    MapPoints,
    Observations,
    PinholeCamera,
    SlamResult,
    TrackingResult,
    TrackingState,
    Trajectory,
    check_depth_estimator,
    check_sequence,
    check_slam,
)
from prgbd.core.errors import ConfigError, ContractError
from prgbd.core.slam import SlamView
from prgbd.core.testing.passive import CheckedSequence, CheckedSLAM
from prgbd.core.testing.planar_scene import planar_scene
from tests.core.plugins import Constant, NotANumber, Ramp


class Still(GeometricSLAM):
    """Says that the camera never moves."""

    modes = frozenset({"mono", "rgbd"})

    def reset(self, camera, mode, *, baseline=None, fps=30.0, seed=0):
        self.camera, self.mode, self.frames = camera, mode, []

    def track(self, frame):
        self.frames.append(frame)
        return TrackingResult(TrackingState.OK, np.eye(4), 10)

    def finish(self):
        n = len(self.frames)
        poses = np.tile(np.eye(4), (n, 1, 1))
        stamps = np.array([f.timestamp for f in self.frames])
        return SlamResult(
            self.camera,
            self.mode,
            n,
            Trajectory(np.arange(n), stamps, poses),
            Keyframes(np.arange(1), stamps[:1], poses[:1], np.zeros(1, np.int32)),
            MapPoints(np.zeros((1, 3)), np.zeros((1, 3), np.uint8)),
            Observations(np.zeros(1, int), np.zeros(1, int), np.zeros((1, 2), np.float32), np.zeros(1, np.float32)),
            ["ok"] * n,
            np.zeros(n, np.int32),
        )


def broken(**changes):
    """A system like ``Still`` whose result is spoilt by ``changes``."""

    class Broken(Still):
        def finish(self):
            return replace(super().finish(), **changes)

    return Broken()


@pytest.fixture
def checked() -> CheckedSLAM:
    return CheckedSLAM(Still(), "Still")


@pytest.fixture
def camera() -> PinholeCamera:
    return PinholeCamera.from_fov(320, 240, 60.0)


def test_a_sound_system_passes(checked) -> None:
    assert check_slam(Still()).frames == 9
    assert check_slam(checked).frames == 9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": 3}, "counts 3 frames"),
        ({"states": ["ok"]}, "states"),
        ({"points": MapPoints(np.full((1, 3), np.nan), np.zeros((1, 3), np.uint8))}, "not finite"),
        ({"points": MapPoints(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))}, "do not exist"),
    ],
)
def test_a_spoilt_result_is_caught(changes, message) -> None:
    with pytest.raises(ContractError, match=message):
        check_slam(broken(**changes))


def test_a_system_that_is_not_repeatable_is_caught() -> None:
    class Random(Still):
        def finish(self):
            result = super().finish()
            poses = result.trajectory.wTc.copy()
            poses[:, 0, 3] = np.random.default_rng().random()
            return replace(result, trajectory=replace(result.trajectory, wTc=poses))

    with pytest.raises(ContractError, match="same frames and seed"):
        check_slam(Random())


class Remembers(Still):
    """Writes a map file, and is lost in every map but its own."""

    loaded = None

    def reset(self, *args, **kwargs):
        super().reset(*args, **kwargs)
        self.loaded = None

    def track(self, frame):
        tracked = super().track(frame)
        return TrackingResult(TrackingState.LOST) if self.loaded not in (None, "the wall") else tracked

    def save_map(self, path):
        path.write_text("the wall")

    def load_map(self, path):
        self.loaded = path.read_text()


class WritesNothing(Remembers):
    def save_map(self, path):
        pass


class FindsNothing(Remembers):
    def save_map(self, path):
        path.write_text("another place")


def test_maps_are_saved_and_loaded_where_a_system_can() -> None:
    check_slam(Remembers())
    with pytest.raises(ContractError, match="writes no file"):
        check_slam(WritesNothing())
    with pytest.raises(ContractError, match="finds none of the frames"):
        check_slam(FindsNothing())


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"points": np.zeros((5, 2))}, r"points have shape \(5, 2\)"), ({"rgb": np.zeros((2, 3))}, "2 colours")],
)
def test_a_spoilt_view_is_caught(changes, message) -> None:
    class Shown(Still):
        def view(self):
            sound = SlamView(np.eye(4)[None], np.zeros((5, 3)), np.zeros((5, 3), np.uint8), np.zeros((1, 2)))
            return replace(sound, **changes)

    with pytest.raises(ContractError, match=message):
        check_slam(Shown())


def test_the_order_of_calls_is_kept(checked, camera) -> None:
    frames = planar_scene(2)
    with pytest.raises(ContractError, match="before reset"):
        checked.track(frames[0])
    checked.reset(camera, "rgbd", baseline=0.1)
    checked.track(frames[0])
    with pytest.raises(ContractError, match="not later"):
        checked.track(frames[0])
    checked.finish()
    with pytest.raises(ContractError, match="before reset"):
        checked.track(frames[1])


@pytest.mark.parametrize(
    ("mode", "baseline", "fps", "message"),
    [("stereo", 0.1, 10.0, "no mode"), ("rgbd", None, 10.0, "baseline"), ("rgbd", -1.0, 10.0, "baseline"),
     ("mono", None, 0.0, "frame rate")],
)  # fmt: skip
def test_a_reset_that_cannot_work_is_refused(checked, camera, mode, baseline, fps, message) -> None:
    with pytest.raises(ConfigError, match=message):
        checked.reset(camera, mode, baseline=baseline, fps=fps)


def test_frames_must_fit_the_camera_and_the_mode(checked, camera) -> None:
    frame = planar_scene(1)[0]
    checked.reset(camera, "rgbd", baseline=0.1)
    with pytest.raises(ContractError, match="no depth"):
        checked.track(frame.with_depth(None))
    with pytest.raises(ContractError, match="NaN"):
        checked.track(frame.with_depth(frame.depth * np.float32(np.nan)))
    with pytest.raises(ContractError, match="camera asks"):
        checked.track(Frame(0, 0.0, frame.image[:100]))


def test_a_pose_that_is_no_rigid_transform_is_caught(camera) -> None:
    class Stretched(Still):
        def track(self, frame):
            super().track(frame)
            return TrackingResult(TrackingState.OK, np.diag([2.0, 1, 1, 1]))

    system = CheckedSLAM(Stretched(), "Stretched")
    system.reset(camera, "mono")
    with pytest.raises(ContractError, match="rigid"):
        system.track(planar_scene(1)[0])


def test_a_sound_estimator_passes() -> None:
    check_depth_estimator(Constant())


def test_spoilt_estimators_are_caught() -> None:
    class Detached(Constant):
        def forward(self, images):
            prediction = super().forward(images)
            return replace(prediction, depths=(prediction.depth.detach().requires_grad_(),))

    class Forgetful(Constant):
        def load_weights(self, folder):
            pass

    class WrongSize(Constant):
        def predict(self, image):
            return super().predict(image)[:5]

    class Certain(Constant):
        def forward(self, images):
            prediction = super().forward(images)
            return replace(prediction, sigma=0 * prediction.depth)

    class WrongSigma(Constant):
        def forward(self, images):
            prediction = super().forward(images)
            return replace(prediction, sigma=prediction.depth[..., :5])

    class OtherDepth(Constant):
        def predict_with_sigma(self, image):
            return 2 * self.predict(image), None

    for cls, message in (
        (NotANumber, "positive and finite"),
        (Certain, "sigma that is zero"),
        (WrongSigma, "like the finest depth"),
        (OtherDepth, "other depth in predict_with_sigma"),
        (Detached, "no gradient"),
        (Forgetful, "after save_weights"),
        (WrongSize, "like the image"),
    ):
        with pytest.raises(ContractError, match=message):
            check_depth_estimator(cls())


def test_a_sound_sequence_passes() -> None:
    check_sequence(Ramp())


def test_spoilt_sequences_are_caught() -> None:
    class Negative(Ramp):
        def frame(self, index):
            return super().frame(index % len(self))

    class Unsafe(Ramp):
        def __init__(self):
            super().__init__()
            self.name = "a/b"

    class Wrong(Ramp):
        def frame(self, index):
            return replace(super().frame(index), index=0)

    for cls, message in ((Negative, "IndexError"), (Unsafe, "is named"), (Wrong, "numbers frame")):
        with pytest.raises(ContractError, match=message):
            check_sequence(cls())


def test_a_sequence_without_frames_is_refused() -> None:
    with pytest.raises(ContractError, match="no frames"):
        CheckedSequence(Ramp(frames=0), "Ramp")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"image": np.zeros((240, 320), np.uint8)}, ["frame 0", "(240, 320) uint8", "(240, 320, 3) uint8 RGB"]),
        ({"image": np.zeros((240, 320, 3))}, ["frame 0", "float64", "uint8"]),
        ({"image": None}, ["NoneType"]),
        ({"depth": np.ones((240, 320))}, ["float64", "float32 metres"]),
        ({"depth": np.ones((120, 160), np.float32)}, ["(120, 160)", "(240, 320)"]),
        ({"depth": None}, ["no depth", "'rgbd'"]),
        ({"depth_sigma": np.ones((240, 320))}, ["float64", "float32 like the depth"]),
        ({"depth_sigma": np.zeros((240, 320), np.float32)}, ["deviations of depth", "positive"]),
        ({"timestamp": None}, ["None", "seconds"]),
        ({"timestamp": float("nan")}, ["nan", "finite"]),
    ],
)
def test_ones_own_frames_are_refused_in_one_sentence(checked, camera, changes, words) -> None:
    checked.reset(camera, "rgbd", baseline=0.1)
    with pytest.raises(ContractError) as caught:
        checked.track(replace(planar_scene(1)[0], **changes))
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("second", [0, -1, 0.5, "1"])
def test_frames_are_numbered_upwards(checked, camera, second) -> None:
    first, other = planar_scene(2)
    checked.reset(camera, "rgbd", baseline=0.1)
    checked.track(first)
    with pytest.raises(ContractError, match=r"frame number .*, and the frame before was 0; count frames upwards"):
        checked.track(replace(other, index=second))
    checked.reset(camera, "rgbd", baseline=0.1)
    checked.track(replace(first, index=np.int64(0)))
    checked.track(replace(other, index=7))


def test_a_camera_that_is_none_is_refused(checked) -> None:
    with pytest.raises(ContractError, match=r"tuple where a prgbd\.PinholeCamera"):
        checked.reset((320, 240), "mono")


@pytest.mark.parametrize("image", [np.zeros((32, 64), np.uint8), np.zeros((32, 64, 3)), "image.png"])
def test_only_colour_images_of_bytes_are_predicted_on(image) -> None:
    with pytest.raises(ContractError, match="uint8 RGB"):
        Constant().predict(image)


def test_a_sequence_is_a_series_of_frames() -> None:
    assert [frame.index for frame in CheckedSequence(Ramp(), "Ramp")] == [0, 1, 2, 3]
