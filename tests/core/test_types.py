import numpy as np
import pytest

from prgbd import PinholeCamera
from prgbd.core.errors import ConfigError
from prgbd.core.types import resize_pixels


@pytest.fixture
def camera() -> PinholeCamera:
    return PinholeCamera(640, 480, 525.0, 520.0, 320.0, 240.0)


def test_resizing_an_image_moves_pixels_as_resizing_its_camera_says(camera) -> None:
    """A ramp resized by an integer factor has known values at the new pixel centres."""
    cv2 = pytest.importorskip("cv2")
    half = camera.resized(320, 240)
    columns = np.tile(np.arange(640, dtype=np.float32), (480, 1))
    resized = cv2.resize(columns, (320, 240), interpolation=cv2.INTER_AREA)
    point = np.array([[0.3, -0.2, 2.0]])
    u_full, u_half = camera.project(point)[0, 0], half.project(point)[0, 0]
    at_half = np.interp(u_half, np.arange(320), resized[100])
    assert at_half == pytest.approx(u_full, abs=1e-3)
    assert half.resized(640, 480) == camera


def test_projecting_undoes_backprojecting(camera) -> None:
    pixels = np.random.default_rng(0).uniform(0, 400, (20, 2))
    depth = np.linspace(1.0, 30.0, 20)
    assert np.allclose(camera.project(camera.backproject(pixels, depth)), pixels)


def test_a_flipped_camera_sees_the_mirrored_pixel(camera) -> None:
    point = np.array([[0.5, 0.1, 3.0]])
    mirrored = point * [-1, 1, 1]
    assert camera.flipped().project(mirrored)[0, 0] == pytest.approx(639 - camera.project(point)[0, 0])


def test_the_field_of_view_spans_the_image() -> None:
    camera = PinholeCamera.from_fov(100, 50, 90.0)
    edge = camera.project(np.array([[1.0, 0.0, 1.0]]))[0, 0]
    assert edge == pytest.approx(99.5)  # the outer border of the last pixel


@pytest.mark.parametrize("fov", [0.0, -3.0, 180.0])
def test_an_impossible_field_of_view_is_refused(fov) -> None:
    with pytest.raises(ConfigError, match="field of view"):
        PinholeCamera.from_fov(100, 50, fov)


@pytest.mark.parametrize("values", [(0, 480, 5, 5, 1, 1), (640, 480, -5, 5, 1, 1), (640, 480, 5, np.nan, 1, 1)])
def test_an_impossible_camera_is_refused(values) -> None:
    with pytest.raises(ConfigError, match="calibration"):
        PinholeCamera(*values)


def test_pixels_and_cameras_are_resized_by_one_rule() -> None:
    uv = np.array([[-0.5, -0.5], [99.5, 59.5], [10.0, 20.0]])
    camera = PinholeCamera(100, 60, 80.0, 75.0, 10.0, 20.0)
    small, scale = camera.resized(50, 20), np.array([1 / 2, 1 / 3])
    expected = [[-0.5, -0.5], [49.5, 19.5], [small.cx, small.cy]]
    np.testing.assert_allclose(resize_pixels(uv, scale), expected)
    rays = camera.backproject(uv, np.ones(3))
    np.testing.assert_allclose(small.project(rays), expected)
