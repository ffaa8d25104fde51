"""Alignment of patches: known shifts are found to a fraction of a pixel, and what does not fit is said to disagree."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.features.patch_alignment import AGREES, DISAGREES, UNDECIDED, align_patches
from prgbd.plugins.slam.orb_gtsam.features.recent_images import RecentImages

SIZES = [(160, 120), (80, 60)]
CENTRES = np.array([[40.0, 40.0], [80.0, 60.0], [120.0, 40.0], [60.0, 90.0], [110.0, 80.0]])


def texture(seed: int) -> NDArray[np.float32]:
    noise = np.random.default_rng(seed).uniform(0, 255, (120, 160)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.asarray(127 + (smooth - smooth.mean()) * (45 / smooth.std()), np.float32)


def moved(image: NDArray[np.float32], scale: float, shift: tuple[float, float]) -> NDArray[np.float32]:
    """Return the image of which pixel ``scale * p + shift`` shows what ``image`` shows at p."""
    M = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]], np.float64)
    return np.asarray(cv2.warpAffine(image, M, (160, 120), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))


def pyramid(image: NDArray[np.float32]) -> list[NDArray[np.uint8]]:
    first = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return [first, np.asarray(cv2.resize(first, SIZES[1], interpolation=cv2.INTER_AREA), np.uint8)]


def align(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    start: NDArray[np.float64],
    *,
    scale: float = 1.0,
    centres: NDArray[np.float64] = CENTRES,
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    images = RecentImages(SIZES, 3)
    images.add(4, pyramid(first))
    images.add(7, pyramid(second))
    slots = images.slots(8)
    n = len(centres)
    xy, outcome = start.copy(), np.full(n, -1, np.int8)
    level = np.zeros(n, np.int64)
    warp = np.tile(scale * np.eye(2), (n, 1, 1))
    align_patches(
        images.pixels,
        images.offset,
        images.width,
        images.height,
        np.full(n, slots[4]),
        level,
        centres,
        np.full(n, slots[7]),
        level,
        warp,
        0.8,
        xy,
        outcome,
    )
    return xy, outcome


@pytest.mark.parametrize(("scale", "shift"), [(1.0, (0.4, -0.7)), (1.0, (-1.3, 0.2)), (1.15, (-9.0, -8.3))])
def test_known_motion_is_found_to_a_tenth_of_a_pixel(scale: float, shift: tuple[float, float]) -> None:
    image = texture(0)
    truth = scale * CENTRES + shift
    xy, outcome = align(image, moved(image, scale, shift), np.rint(truth), scale=scale)
    assert (outcome == AGREES).all()
    np.testing.assert_allclose(xy, truth, atol=0.1)  # warpAffine knows 32 places between two pixels


def test_brightness_and_contrast_do_not_matter() -> None:
    image = texture(1)
    xy, outcome = align(image, 0.6 * moved(image, 1.0, (0.5, 0.5)) + 60, CENTRES)
    assert (outcome == AGREES).all()
    np.testing.assert_allclose(xy, CENTRES + 0.5, atol=0.06)


def test_other_texture_disagrees_and_stays_where_it_is() -> None:
    xy, outcome = align(texture(2), texture(3), CENTRES)
    assert (outcome == DISAGREES).all()
    np.testing.assert_array_equal(xy, CENTRES)


def test_what_is_farther_than_two_pixels_is_not_the_same_corner() -> None:
    image = texture(4)
    xy, outcome = align(image, moved(image, 1.0, (3.0, 0.0)), CENTRES)
    assert not (outcome == AGREES).any()
    np.testing.assert_array_equal(xy, CENTRES)


def test_nothing_is_said_of_flat_patches_and_of_those_that_leave_the_image() -> None:
    flat = np.full((120, 160), 90.0, np.float32)
    assert (align(flat, flat, CENTRES)[1] == UNDECIDED).all()
    stripes = np.tile(127 + 100 * np.sin(np.arange(160) / 3), (120, 1)).astype(np.float32)
    assert (align(stripes, stripes, CENTRES)[1] == UNDECIDED).all()
    corners = np.array([[2.0, 60.0], [157.0, 60.0], [80.0, 1.0], [80.0, 118.0]])
    image = texture(5)
    assert (align(image, image, corners, centres=corners)[1] == UNDECIDED).all()
    middle = np.tile([[80.0, 60.0]], (4, 1))
    assert (align(image, image, corners, centres=middle)[1] == UNDECIDED).all()


def test_the_ring_keeps_the_last_pyramids() -> None:
    images = RecentImages(SIZES, 2)
    for keyframe in (0, 2, 5):
        images.add(keyframe, pyramid(np.full((120, 160), 10.0 * keyframe, np.float32)))
    slots = images.slots(6)
    assert (slots >= 0).tolist() == [False, False, True, False, False, True]
    assert (images.pixels[slots[5]] == 50).all()
    assert (images.pixels[slots[2]] == 20).all()


def test_levels_and_image_agree_on_where_a_pixel_is() -> None:
    images = RecentImages([(161, 120), (80, 60)], 1)
    octave = np.array([0, 1])
    xy = np.array([[0.0, 0.0], [79.0, 59.0]])
    uv = images.to_image(xy, octave)
    np.testing.assert_allclose(uv[0], [0.0, 0.0])
    np.testing.assert_allclose(uv[1], [79.5 * 161 / 80 - 0.5, 118.5])
    np.testing.assert_allclose(images.to_level(uv, octave), xy)
