"""The synthetic worlds: repeatable, consistent with their truth, closed, free of collisions, fit for ORB.

Building a street takes seconds, so most tests look at the seed 1, which is built once.
"""

from __future__ import annotations

import pickle

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from prgbd import check_sequence, make_data
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data.synthetic import SyntheticSequence
from tests.contracts import SequenceContract
from tests.plugins.data.warping import warp_error

SCENES = ("street", "indoor")
SMALL = {"width": 192, "height": 128, "frames": 20}


@pytest.fixture(scope="module", params=SCENES)
def clean(request) -> SyntheticSequence:
    return SyntheticSequence(scene=request.param, seed=3, frames=40, noise=0, exposure=0)


class TestStreetContract(SequenceContract):
    @pytest.fixture
    def sequence(self) -> SyntheticSequence:
        return SyntheticSequence("street-0", **SMALL)


class TestRoomContract(SequenceContract):
    @pytest.fixture
    def sequence(self) -> SyntheticSequence:
        return SyntheticSequence("indoor-1", **SMALL, sensor_depth=True, depth_noise=0.01, baseline=0.1)


@pytest.mark.parametrize("scene", SCENES)
def test_frames_do_not_depend_on_order_or_length(scene: str) -> None:
    forwards = SyntheticSequence(scene=scene, seed=1, **SMALL)
    backwards = SyntheticSequence(scene=scene, seed=1, **{**SMALL, "frames": 35})
    images = [forwards.frame(i).image for i in range(8)]
    for i in reversed(range(8)):
        np.testing.assert_array_equal(backwards.frame(i).image, images[i])
    np.testing.assert_array_equal(backwards.poses[:20], forwards.poses)


def test_a_pickled_copy_renders_the_same() -> None:
    sequence = SyntheticSequence("street-1", **SMALL)
    image = sequence.frame(4).image
    stored = pickle.dumps(sequence)
    assert len(stored) < 20_000
    np.testing.assert_array_equal(pickle.loads(stored).frame(4).image, image)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("street-1", [[149, 81, 78, 94, 138, 151], [99, 61, 79, 79, 106, 87], [86, 96, 89, 83, 84, 80]]),
        ("indoor-1", [[140, 115, 113, 85, 107, 119], [86, 113, 99, 76, 94, 105], [85, 95, 94, 96, 90, 100]]),
    ],
)
def test_the_look_stays_the_one_that_the_demo_weights_were_trained_on(name: str, expected: list[list[int]]) -> None:
    grey = cv2.cvtColor(SyntheticSequence(name, frames=20, noise=0, exposure=0).frame(10).image, cv2.COLOR_RGB2GRAY)
    found = grey.astype(float).reshape(4, 64, 6, 64).mean(axis=(1, 3))[:3]
    np.testing.assert_allclose(found, expected, atol=2)


def test_memory_of_frames_is_bounded() -> None:
    sequence = SyntheticSequence("indoor-0", **SMALL)
    for i in range(12):
        sequence.frame(i)
    assert len(sequence._memo) <= 4


@pytest.mark.parametrize("scene", SCENES)
def test_seeds_make_different_worlds(scene: str) -> None:
    first, second = (SyntheticSequence(scene=scene, seed=seed, **SMALL).frame(0).image for seed in (0, 1))
    assert np.abs(first.astype(float) - second).mean() > 10


def test_warping_by_true_depth_and_pose_explains_the_next_frame(clean: SyntheticSequence) -> None:
    for i in (2, 30):
        right = warp_error(clean, i, i + 1)
        assert right < 2.5
        assert right < 0.25 * warp_error(clean, i, i + 1, identity=True)


def test_pixels_are_counted_from_their_centres(clean: SyntheticSequence) -> None:
    assert warp_error(clean, 5, 6) < 0.8 * min(warp_error(clean, 5, 6, shift) for shift in (-0.5, 0.5))


def test_the_right_image_lies_at_the_disparity_of_the_true_depth() -> None:
    sequence = SyntheticSequence("street-1", frames=3, baseline=0.5, noise=0, exposure=0)
    frame, depth = sequence.frame(1), sequence.depth(1)
    u, v = np.meshgrid(np.arange(384, dtype=np.float32), np.arange(256, dtype=np.float32))
    known = depth > 0
    x = (u - sequence.camera.fx * 0.5 / np.where(known, depth, np.inf)).astype(np.float32)
    warped = cv2.remap(frame.right, x, v, cv2.INTER_LINEAR)
    difference = np.abs(warped.astype(float) - frame.image).mean(axis=2)
    assert np.median(difference[known & (x > 0)]) < 3


def test_orb_finds_enough_corners(clean: SyntheticSequence) -> None:
    for i in range(0, 40, 8):
        grey = cv2.cvtColor(clean.frame(i).image, cv2.COLOR_RGB2GRAY)
        assert len(cv2.FastFeatureDetector_create(7).detect(grey)) > 1000
        assert len(cv2.ORB_create(1000, fastThreshold=7).detect(grey)) > 500


@pytest.mark.parametrize(("scene", "near", "far"), [("street", 1.0, 140.0), ("indoor", 0.4, 9.0)])
def test_depths_are_those_of_such_a_scene(scene: str, near: float, far: float) -> None:
    sequence = SyntheticSequence(scene=scene, seed=1, frames=200)
    for i in (0, 100, 199):
        depth = sequence.depth(i)
        known = depth[depth > 0]
        assert near < known.min()
        assert known.max() < far
    assert (sequence.depth(0)[:8] == 0).any() == (scene == "street")
    if scene == "indoor":
        assert (depth > 0).all()


@pytest.mark.parametrize(("scene", "lap"), [("street", 480), ("indoor", 300)])
@pytest.mark.parametrize("seed", [1, 7])
def test_the_path_closes_moves_smoothly_and_meets_nothing(scene: str, lap: int, seed: int) -> None:
    sequence = SyntheticSequence(scene=scene, seed=seed, frames=lap)
    places = sequence.poses[:, :3, 3]
    away = np.linalg.norm(places - places[0], axis=1)
    assert away[lap // 3 :].min() < 1.2
    assert away.max() > (30 if scene == "street" else 1.5)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    low, high = (0.3, 0.9) if scene == "street" else (0.02, 0.08)
    assert low < steps.min()
    assert steps.max() < high
    turns = np.einsum("nji,njk->nik", sequence.poses[:-1, :3, :3], sequence.poses[1:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angle.max() < 4
    surfaces = sequence._world.stage.surfaces
    tree = cKDTree(places)
    grid = [(a, b) for a in np.linspace(0, 1, 9) for b in np.linspace(0, 1, 9)]
    samples = [surfaces.quads[:, 0] + a * surfaces.quads[:, 1] + b * surfaces.quads[:, 2] for a, b in grid]
    nearest = min(tree.query(sample)[0].min() for sample in samples)
    assert nearest > (1.0 if scene == "street" else 0.35)
    inside = ((places[:, None] - surfaces.balls[:, 0]) / surfaces.balls[:, 1]) ** 2
    assert inside.sum(axis=2).min() > 1.5


def test_more_frames_go_further_not_slower() -> None:
    short, long = (SyntheticSequence("street-0", frames=n).poses[:, :3, 3] for n in (50, 3000))
    np.testing.assert_array_equal(long[:50], short)
    assert np.linalg.norm(np.diff(long, axis=0), axis=1).sum() > 1500


def test_the_reverse_path_goes_the_other_way() -> None:
    there, back = (SyntheticSequence("indoor-0", frames=80, path=path).poses for path in ("loop", "reverse"))
    turn = [p[0, 0, 3] * p[60, 2, 3] - p[0, 2, 3] * p[60, 0, 3] for p in (there, back)]
    assert turn[0] * turn[1] < 0


@pytest.mark.parametrize("scene", SCENES)
def test_moving_objects_change_images_and_leave_the_rest(scene: str) -> None:
    still = SyntheticSequence(scene=scene, seed=1, frames=60, width=192, height=128)
    busy = SyntheticSequence(scene=scene, seed=1, frames=60, moving_objects=6, width=192, height=128)
    np.testing.assert_array_equal(still.poses, busy.poses)
    changed = []
    for i in range(0, 60, 6):
        differs = np.abs(still.frame(i).image.astype(int) - busy.frame(i).image).max(axis=2) > 0
        moved = busy.depth(i) != still.depth(i)
        # The truth includes what moves, and what moves can only hide what is farther.
        behind = np.where(still.depth(i) > 0, still.depth(i), np.inf)
        assert np.count_nonzero(busy.depth(i)[moved] > behind[moved]) <= 0.02 * np.count_nonzero(moved)
        changed.append(differs.mean())
        assert differs.mean() < 0.7
    assert max(changed) > 0.005


def test_the_sensor_reports_the_true_depth_with_the_noise_asked_for() -> None:
    exact = SyntheticSequence("indoor-0", **SMALL, sensor_depth=True)
    np.testing.assert_array_equal(exact.frame(3).depth, exact.depth(3))
    noisy = SyntheticSequence("indoor-0", **SMALL, sensor_depth=True, depth_noise=0.02)
    assert np.std(noisy.frame(3).depth / noisy.depth(3)) == pytest.approx(0.02, rel=0.1)
    assert SyntheticSequence("indoor-0", **SMALL).frame(3).depth is None


def test_names_choose_worlds() -> None:
    names = SyntheticSequence.available()
    assert "street-0" in names
    sequence = make_data("synthetic", sequence="indoor-7", **SMALL)
    assert (sequence.name, len(sequence), sequence.fps) == ("indoor-7", 20, pytest.approx(10))
    check_sequence(sequence, frames=2)


@pytest.mark.parametrize("name", ["desert-0", "street", "street-x", "../street-0"])
def test_an_unknown_world_is_refused(name: str) -> None:
    with pytest.raises(DataError, match="no synthetic sequence"):
        SyntheticSequence(name)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("scene", "desert"),
        ("path", "spiral"),
        ("frames", 0),
        ("seed", -1),
        ("fps", 0.0),
        ("fps", float("nan")),
        ("fov", 180.0),
        ("width", 0),
        ("moving_objects", -1),
        ("baseline", 0.0),
        ("noise", -1.0),
        ("depth_noise", float("nan")),
    ],
)
def test_impossible_options_are_refused(option: str, value: object) -> None:
    with pytest.raises(ConfigError):
        make_data("synthetic", **{option: value})
