"""Lenses: the fisheye camera, and what must hold of the coefficients of any lens."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.core.types import PinholeCamera
from prgbd.core.undistortion import Maps, undistortion_maps

log = logging.getLogger("prgbd")

LARGEST_TANGENTIAL = 0.02  # of real lenses, which stand well before their sensors
UNUSUAL_TANGENTIAL = 0.008
WIDE = 95.0  # degrees; a lens that sees more and does not bend straight lines is rare
BENDS = 0.9  # of its distance from the middle a wide lens shows the corner at, or nearer
FOLDS = 0.8  # of the way to the corner: a distortion that turns back before belongs to another lens
STRENGTH = (0.25, 2.0)  # how much nearer to the middle, or farther, a lens may show the corner
FISHEYE = "if these are k1 to k4 of a fisheye (equidistant, Kannala-Brandt) lens, write 'model: fisheye' into it"


@dataclass(frozen=True)
class FisheyeCamera(PinholeCamera):
    """A camera with OpenCV's fisheye lens (equidistant, Kannala-Brandt).

    Its ``distortion`` are the coefficients k1 to k4 of ``cv2.fisheye``.
    """

    def undistorted(self) -> PinholeCamera:
        """Return the pinhole camera of the undistorted images; it has the same focal length."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


@undistortion_maps.register
def _fisheye_maps(camera: FisheyeCamera) -> Maps:
    size, coefficients = (camera.width, camera.height), np.array(camera.distortion)
    u, v = cv2.fisheye.initUndistortRectifyMap(camera.K, coefficients, np.eye(3), camera.K, size, cv2.CV_32FC1)
    return np.asarray(u, np.float32), np.asarray(v, np.float32)


def check_lens(camera: PinholeCamera, source: str, model: str | None) -> None:
    """Check that the coefficients can be those of a lens that took such images; what is doubtful is said in a warning.

    Args:
        camera: The camera with its distortion.
        source: Its file or option, for messages.
        model: The model that the source names; None where it names none, so that four numbers are ambiguous.

    Raises:
        DataError: If the picture would be folded, or the coefficients are none of such a lens.
    """
    if not any(camera.distortion):
        return
    fisheye = isinstance(camera, FisheyeCamera)
    ambiguous = model is None and len(camera.distortion) == 4
    mend = FISHEYE if ambiguous else "check the order of the numbers and the model"
    if not fisheye:
        tangential = max(abs(number) for number in camera.distortion[2:4])
        said = f"{source} has the tangential coefficients p1={camera.distortion[2]:g}, p2={camera.distortion[3]:g}"
        if tangential > LARGEST_TANGENTIAL:
            raise DataError(f"{said}, which are too large for a lens (k1, k2, p1, p2[, k3]); {mend}.")
        if ambiguous and tangential > UNUSUAL_TANGENTIAL:
            log.warning("%s, which are unusually large; %s, else 'model: opencv'.", said, FISHEYE)
    farthest = _corner(camera)
    radii = np.linspace(0.0, farthest, 200)[1:]
    shown = _shown(camera, radii)
    turns = np.flatnonzero(~(np.diff(shown) > 0))
    if not np.isfinite(shown).all() or (len(turns) and radii[turns[0]] < FOLDS * farthest):
        where = f"{radii[turns[0]] / farthest:.0%} of the way to the corner" if len(turns) else "the picture"
        raise DataError(f"The distortion in {source} folds the picture back at {where}, which no lens does; {mend}.")
    if not STRENGTH[0] < shown[-1] / farthest < STRENGTH[1]:
        times = shown[-1] / farthest
        raise DataError(
            f"The distortion in {source} moves the corner {times:.2g} times as far from the middle; {mend}."
        )
    if len(turns):
        log.warning("The distortion in %s folds the outermost corners of the picture back; calibrate anew.", source)
    wide = np.degrees(2 * np.arctan(camera.width / (2 * camera.fx))) > WIDE
    if ambiguous and wide and shown[-1] / farthest > BENDS:
        log.warning("%s has a wide lens that hardly bends straight lines; %s, else 'model: opencv'.", source, FISHEYE)


def _corner(camera: PinholeCamera) -> float:
    """The tangent of the angle to the axis under which a pinhole camera sees its farthest corner."""
    x = max(camera.cx, camera.width - 1 - camera.cx) / camera.fx
    y = max(camera.cy, camera.height - 1 - camera.cy) / camera.fy
    return float(np.hypot(x, y))


def _shown(camera: PinholeCamera, radii: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far from the middle, in focal lengths, the lens shows rays; tangential parts do not count."""
    if isinstance(camera, FisheyeCamera):
        angles = np.arctan(radii)
        return angles * (1 + np.polyval([*camera.distortion[::-1], 0.0], angles**2))
    k = np.zeros(8)
    k[: min(8, len(camera.distortion))] = camera.distortion[:8]
    above, below = (1 + np.polyval([*numbers[::-1], 0.0], radii**2) for numbers in (k[[0, 1, 4]], k[5:8]))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(radii * above / below, np.float64)
