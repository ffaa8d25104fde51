"""Cameras from YAML files or a field of view, and undistortion."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError, SlamError
from prgbd.core.types import PinholeCamera
from prgbd.plugins.data._camera_files import read_camera_file
from prgbd.plugins.data._lens import FisheyeCamera, check_lens
from prgbd.plugins.data.calibration import can_estimate, estimate_camera

log = logging.getLogger("prgbd")

INTRINSICS = ("fx", "fy", "cx", "cy")
KEYS = ("width", "height", *INTRINSICS, "distortion", "model", "fov_degrees")
LENSES = {"pinhole": (0,), "opencv": (0, 4, 5, 8, 12, 14), "fisheye": (4,)}
"""How many coefficients a lens of each model has."""
ANOTHER_SIZE = 0.1  # by which the principal point is off the middle, by one ratio in both directions
ONE_RATIO = 0.03


def known_or_estimated(
    camera: str | Path | Mapping[str, Any] | None,
    fov: float | None,
    beside: Path,
    where: Path,
    image: Callable[[int], NDArray[np.uint8]],
    count: int,
) -> PinholeCamera:
    """Return the camera of a recording from what the user gave, from a file beside it, or from its images.

    What COLMAP estimates is kept in the file beside the recording, so that it is done once.

    Args:
        camera: As for ``make_camera``.
        fov: As for ``make_camera``.
        beside: The camera file that is taken where neither is given.
        where: The recording, for messages.
        image: Returns an image of the recording, (H, W, 3) uint8 RGB.
        count: Number of images.

    Raises:
        ConfigError: If nothing is known of the camera and it cannot be estimated; the message names the three mends.
        DataError: If the YAML is absent, malformed, or made for images of another size.
    """
    height, width = image(0).shape[:2]
    if camera is None and fov is None and beside.is_file():
        camera = beside
    if camera is not None or fov is not None:
        return make_camera(camera, fov, width, height, where)
    mends = (
        "set data.fov to the horizontal field of view in degrees, or data.camera to a YAML file (camera: width, "
        "height, fx, fy, cx, cy, distortion)"
    )
    if not can_estimate():
        raise ConfigError(
            f"The camera of {where} is not known; {mends}, or pip install 'prgbd[colmap]', which estimates it from the "
            "images."
        )
    log.warning("The camera of %s is not known: COLMAP estimates it from the images, which takes minutes.", where)
    try:
        estimate = estimate_camera(image, count, str(where))
    except SlamError:
        raise ConfigError(
            f"The camera of {where} is not known, and its images do not tell; {mends}, or choose a part where the "
            "camera moves sideways past textured things (data.start, data.stop)."
        ) from None
    with contextlib.suppress(OSError):  # a folder that may not be written
        beside.write_text(estimate.to_yaml(where.name), encoding="utf-8")
    kept = f"kept in {beside}" if beside.is_file() else f"{beside} could not be written"
    log.warning("Estimated %s; %s.", estimate.words(), kept)
    return estimate.camera


def make_camera(
    camera: str | Path | Mapping[str, Any] | None, fov: float | None, width: int, height: int, where: Path
) -> PinholeCamera:
    """Return the camera of a recording whose images are ``width`` x ``height`` pixels.

    Args:
        camera: A YAML file, its content, or None.
        fov: Horizontal field of view in degrees, or None. One of the two must be given.
        width: Width of the images in pixels.
        height: Height of the images in pixels.
        where: The recording, for messages.

    Raises:
        ConfigError: If neither or both are given, or the field of view is impossible.
        DataError: If the YAML is absent, malformed, or made for images of another size.
    """
    if (camera is None) == (fov is None):
        missing = "is not known" if camera is None else "is given twice"
        raise ConfigError(
            f"The camera of {where} {missing}; set either data.camera to a YAML file (camera: width, height, fx, fy, "
            "cx, cy, distortion) or data.fov to the horizontal field of view in degrees."
        )
    if camera is None:
        return PinholeCamera.from_fov(width, height, _number(fov, "data.fov"))
    if isinstance(camera, Mapping):
        return camera_from_values(camera, "the option data.camera", width, height)
    path = Path(camera).expanduser()
    return camera_from_values(read_camera_file(path), str(path), width, height)


def camera_from_values(values: Any, source: str, width: int, height: int) -> PinholeCamera:
    """Return the camera that a mapping describes; ``source`` names it in messages.

    Raises:
        DataError: If something is missing, not a number, or does not fit the images.
    """
    inner = values.get("camera", values) if isinstance(values, Mapping) else None
    if not isinstance(inner, Mapping):
        raise DataError(f"{source} holds no mapping 'camera:' with {', '.join(INTRINSICS)} or fov_degrees; write one.")
    unknown = [str(key) for key in inner if key not in KEYS]
    if unknown:
        raise DataError(f"{source} has an unknown entry '{unknown[0]}'; the entries are {', '.join(KEYS)}.")
    stated = "width" in inner or "height" in inner
    size = tuple(
        _whole(inner.get(key, own), f"{key} in {source}") for key, own in (("width", width), ("height", height))
    )
    if size != (width, height):
        raise DataError(
            f"{source} is the camera of {size[0]}x{size[1]} images, but the images are {width}x{height}; "
            "calibrate at this size or resize the images."
        )
    if "fov_degrees" in inner:
        return PinholeCamera.from_fov(width, height, _number(inner["fov_degrees"], f"fov_degrees in {source}"))
    absent = [key for key in INTRINSICS if key not in inner]
    if absent:
        raise DataError(f"{source} lacks {', '.join(absent)}; it needs {', '.join(INTRINSICS)} or fov_degrees.")
    fx, fy, cx, cy = (_number(inner[key], f"{key} in {source}") for key in INTRINSICS)
    model, coefficients = _lens(inner, source)
    camera = plausible(width, height, (fx, fy, cx, cy), coefficients, source)
    if not stated:
        _check_size(camera, source)
    if model == "fisheye":
        camera = FisheyeCamera(width, height, fx, fy, cx, cy, coefficients)
    check_lens(camera, source, model)
    return camera


def _lens(values: Mapping[str, Any], source: str) -> tuple[str | None, tuple[float, ...]]:
    """Return the model, None where none is named, and the coefficients of the lens."""
    model = values.get("model")
    if model is not None and model not in tuple(LENSES):
        raise DataError(f"The model in {source} is '{model}'; it must be one of {', '.join(LENSES)}.")
    given = values.get("distortion")
    given = [] if given is None else given
    if not isinstance(given, (list, tuple)):
        raise DataError(f"The distortion in {source} must be a list of 4, 5 or 8 numbers.")
    coefficients = tuple(_number(value, f"distortion in {source}") for value in given)
    possible = LENSES[model or "opencv"]
    if len(coefficients) not in possible:
        listed = " or ".join(map(str, possible))
        raise DataError(
            f"The distortion in {source} has {len(coefficients)} numbers; the model '{model or 'opencv'}' has {listed}."
        )
    return model, coefficients


def _check_size(camera: PinholeCamera, source: str) -> None:
    """Refuse a camera whose principal point is the middle of images of another size.

    Raises:
        DataError: If it is off the middle by one ratio in both directions.
    """
    x, y = (2 * camera.cx + 1) / camera.width, (2 * camera.cy + 1) / camera.height
    ratio = float(np.sqrt(x * y))
    if abs(ratio - 1) > ANOTHER_SIZE and abs(x / y - 1) < ONE_RATIO:
        raise DataError(
            f"{source} has its principal point in the middle of images of about {x * camera.width:.0f}x"
            f"{y * camera.height:.0f} pixels, but the images are {camera.width}x{camera.height}; multiply fx, fy, "
            f"cx and cy by {1 / ratio:.3g}, or calibrate at this size, and write width and height into it."
        )


def plausible(
    width: int, height: int, intrinsics: tuple[float, float, float, float], distortion: tuple[float, ...], source: str
) -> PinholeCamera:
    """Return the camera if its numbers can belong to images of this size.

    Raises:
        DataError: If a focal length is not positive, or the numbers are normalised or those of another image size.
    """
    fx, fy, cx, cy = intrinsics
    if not np.all(np.isfinite([*intrinsics, *distortion])) or min(fx, fy) <= 0:
        raise DataError(
            f"{source} gives fx={fx:g}, fy={fy:g}, cx={cx:g}, cy={cy:g}; the focal lengths must be positive."
        )
    if max(fx, fy, cx, cy) < 10:
        raise DataError(
            f"{source} gives fx={fx:g}, fy={fy:g}, cx={cx:g}, cy={cy:g}, which look normalised; "
            "multiply them by the width and height of the images in pixels."
        )
    if not (0 < cx < width and 0 < cy < height):
        raise DataError(
            f"{source} has its principal point ({cx:g}, {cy:g}) outside the {width}x{height} images; "
            "it belongs to another image size or is malformed."
        )
    return PinholeCamera(width, height, fx, fy, cx, cy, distortion)


def _whole(value: Any, what: str) -> int:
    number = _number(value, what)
    if number != int(number):
        raise DataError(f"{what} is {number:g}, which is no whole number; mend it.")
    return int(number)


def _number(value: Any, what: str) -> float:
    try:
        # Python takes True for 1; YAML reads 5e2 as text, which is meant as a number.
        number = float("true" if isinstance(value, bool) else value)
    except (TypeError, ValueError, OverflowError):
        raise DataError(f"{what} is {value!r}, which is no number; mend it.") from None
    if not np.isfinite(number):
        raise DataError(f"{what} is {number}, which is not finite; mend it.")
    return number
