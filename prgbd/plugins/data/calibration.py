"""A camera that nobody calibrated: its focal length and distortion from the images themselves, by ``slam=colmap``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import SlamError
from prgbd.core.registry import REGISTRY
from prgbd.core.slam import Listener
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.plugins.data.image_motion import median_motion, small

IMAGES = 24  # of a piece of the recording
PIECES = 3  # at most, spread over the recording
SHARE = 0.6  # of a piece's images must be registered for it to count
MOTION = 12.0  # pixels (of 320) between two images of a piece
LARGEST_STEP = 30  # frames between them
LARGEST = 1280  # pixels of width; larger images are shrunk
FIELD_OF_VIEW = (15.0, 150.0)  # degrees that an estimate may have
SEVERAL_DIFFER = 0.05  # relative; pieces that differ by more are worth a word
OPTIONS: dict[str, Any] = {"every": 1, "intrinsics": "unknown", "features": 2048, "overlap": 6}

Image = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True)
class Estimate:
    """What was found.

    Attributes:
        camera: The camera of the images as they are, with one radial distortion.
        focal_lengths: Of every piece of the recording that COLMAP could reconstruct, pixels.
        images: Number of images that they were found from.
    """

    camera: PinholeCamera
    focal_lengths: tuple[float, ...]
    images: int

    @property
    def field_of_view(self) -> float:
        """Horizontal, in degrees."""
        return float(np.degrees(2 * np.arctan(self.camera.width / (2 * self.camera.fx))))

    @property
    def spread(self) -> float:
        """Largest relative difference of a piece's focal length from the camera's; 0 with one piece."""
        return max(abs(f / self.camera.fx - 1) for f in self.focal_lengths)

    def words(self) -> str:
        """Say it in a line."""
        said = f"focal length {self.camera.fx:.0f} pixels (field of view {self.field_of_view:.0f} degrees)"
        said += f" from {self.images} images"
        if len(self.focal_lengths) > 1:
            listed = ", ".join(f"{f:.0f}" for f in self.focal_lengths)
            said += f" of {len(self.focal_lengths)} pieces ({listed})"
        if self.spread > SEVERAL_DIFFER:
            return f"{said}; the pieces differ, so calibrate by checkerboard if you can"
        if len(self.focal_lengths) > 1:
            return f"{said}; that they agree is no proof, since one motion can mislead them all: it may be off by 5 %"
        return f"{said}; one piece alone, which may be off by 10 % or more"

    def to_yaml(self, name: str) -> str:
        """Return the content of a camera file, as ``data=video`` and ``data=images`` read it."""
        c = self.camera
        distortion = ", ".join(f"{k:.5f}" for k in c.distortion)
        return (
            f"# Estimated by COLMAP from {name}: {self.words()}\n"
            f"camera: {{width: {c.width}, height: {c.height}, fx: {c.fx:.2f}, fy: {c.fy:.2f}, cx: {c.cx:.2f}, "
            f"cy: {c.cy:.2f}, distortion: [{distortion}]}}\n"
        )


def can_estimate() -> bool:
    """Return whether the extra ``colmap`` is installed."""
    return not REGISTRY.resolve("slam", "colmap").missing


def estimate_camera(image: Image, count: int, name: str, tell: Listener | None = None) -> Estimate:
    """Estimate the camera of a recording.

    Up to three pieces of the recording are reconstructed with unknown intrinsics, on images that are so far apart that
    the picture moves noticeably, and the piece with the middle focal length gives the camera.

    Args:
        image: Returns an image of the recording, (H, W, 3) uint8 RGB.
        count: Number of images.
        name: Of the recording, for messages.
        tell: Told of the progress.

    Raises:
        BrokenPluginError: If the extra ``colmap`` is not installed.
        SlamError: If no piece can be reconstructed.
    """
    found: list[SlamResult] = []
    used = 0
    for piece in pieces(count, step_of(image, count)):
        result = _reconstructed(image, piece, tell)
        if result is not None:
            found.append(result)
            used += len(result.keyframes)
    if not found:
        raise SlamError(
            f"COLMAP could not estimate the camera of {name}: the camera must move sideways past textured things; set "
            "data.fov to the horizontal field of view in degrees instead."
        )
    found.sort(key=lambda result: result.camera.fx)
    middle = found[len(found) // 2] if len(found) != 2 else max(found, key=lambda result: len(result.keyframes))
    height, width = image(0).shape[:2]
    k = next(iter(middle.camera.distortion), 0.0)
    full = replace(middle.camera, distortion=(round(k, 5), 0.0, 0.0, 0.0)).resized(width, height)
    # As precise as the file that it is kept in, so that it is the same with and without it.
    camera = replace(full, **{name: round(getattr(full, name), 2) for name in ("fx", "fy", "cx", "cy")})
    return Estimate(camera, tuple(float(result.camera.fx) * width / result.camera.width for result in found), used)


def step_of(image: Image, count: int) -> int:
    """Return how many frames apart images should be for the picture to move by ``MOTION`` pixels of 320."""
    motions = []
    for start in np.unique(np.linspace(0, count - 2, 5).astype(int)) if count > 1 else []:
        motion = median_motion(small(image(int(start))), small(image(int(start) + 1)))
        if motion is not None:
            motions.append(motion)
    if not motions:
        return min(5, max(1, count // IMAGES))
    step = round(MOTION / max(float(np.median(motions)), MOTION / LARGEST_STEP))
    return int(np.clip(step, 1, max(1, count // (IMAGES // 2))))


def pieces(count: int, step: int) -> list[range]:
    """Return the frames of each piece."""
    length = (IMAGES - 1) * step + 1
    if count <= length:
        return [range(0, count, step)]
    number = min(PIECES, count // length)
    starts = [(count - length) // 2] if number == 1 else np.linspace(0, count - length, number).astype(int).tolist()
    return [range(start, start + length, step) for start in starts]


def _reconstructed(image: Image, frames: range, tell: Listener | None) -> SlamResult | None:
    """Return COLMAP's reconstruction of some frames, or None where it has none that means anything."""
    first = image(frames[0])
    shrunk = min(1.0, LARGEST / first.shape[1])
    width, height = round(first.shape[1] * shrunk), round(first.shape[0] * shrunk)
    with REGISTRY.make("slam", "colmap", **OPTIONS) as system:
        system.reset(PinholeCamera.from_fov(width, height, 60.0), "mono")
        system.listen(tell)
        for position, index in enumerate(frames):
            picture = image(index)
            if shrunk < 1:
                picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
            system.track(Frame(position, position / 10.0, picture))
        try:
            result: SlamResult = system.finish()
        except SlamError:
            return None
    fov = float(np.degrees(2 * np.arctan(width / (2 * result.camera.fx))))
    enough = len(result.keyframes) >= max(3, SHARE * len(frames))
    return result if enough and FIELD_OF_VIEW[0] < fov < FIELD_OF_VIEW[1] else None
