"""A look at a recording before a run: the mistakes that most users of such systems make with their own data."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import PrgbdError

PAIRS = 10  # neighbouring frames that are looked at, spread over the recording
WIDTH = 320  # pixels that they are shrunk to
STILL = 0.3  # pixels of median flow at that width below which nothing moves
FAST = 40.0  # above which features are hard to follow
SAME = 0.05  # mean grey levels of difference below which two frames are one
DARK, BRIGHT = 30.0, 225.0  # mean grey levels
FIELD_OF_VIEW = (25.0, 130.0)  # degrees, horizontal


@dataclass(frozen=True)
class Preflight:
    """What was found.

    Attributes:
        facts: One line of numbers.
        warnings: A clause for each thing that looks wrong, with the mend.
    """

    facts: str
    warnings: tuple[str, ...]

    def lines(self) -> tuple[str, str]:
        """The two lines to show."""
        return self.facts, "; ".join(self.warnings) if self.warnings else "nothing unusual"


def preflight(sequence: Sequence) -> Preflight:
    """Look at motion, duplicates, exposure, frame rate and calibration of a recording, on a few pairs of frames.

    Frames that cannot be read are left out: the run itself names them.
    """
    starts = np.unique(np.linspace(0, max(0, len(sequence) - 2), PAIRS).astype(int))[: len(sequence) - 1]
    flows, differences, levels = [], [], []
    for start in starts:
        try:
            first, second = (_small(sequence.frame(int(index)).image) for index in (start, start + 1))
        except PrgbdError:
            continue
        levels.append(float(first.mean()))
        differences.append(float(cv2.absdiff(first, second).mean()))
        flow = _flow(first, second)
        if flow is not None:
            flows.append(flow)
    camera = sequence.camera
    fov = float(np.degrees(2 * np.arctan(camera.width / (2 * camera.fx))))
    motion = float(np.median(flows)) * camera.width / WIDTH if flows else None
    facts = [f"{len(sequence)} frames at {sequence.fps:.1f} Hz", f"field of view {fov:.0f} degrees"]
    if motion is not None:
        facts.append(f"motion {motion:.1f} pixels a frame")
    if levels:
        facts.append(f"brightness {np.mean(levels):.0f} of 255")
    warnings = (*_of_images(flows, differences, levels), *_of_times(sequence), *_of_camera(sequence, fov))
    return Preflight(", ".join(facts), warnings)


def _of_images(flows: list[float], differences: list[float], levels: list[float]) -> list[str]:
    found = []
    same = sum(difference < SAME for difference in differences)
    if same:
        found.append(f"{same} of {len(differences)} neighbouring frames are the same picture; raise data.step or fps")
    elif flows and np.median(flows) < STILL:
        found.append("hardly anything moves, so nothing can be triangulated; choose another part or raise data.step")
    if flows and np.median(flows) > FAST:
        found.append("the picture moves fast; use a higher frame rate or a smaller data.step")
    if levels and len(flows) < 0.5 * len(levels):
        found.append("there is too little texture to follow in most frames")
    if levels and np.mean(levels) < DARK:
        found.append("the images are very dark")
    if levels and np.mean(levels) > BRIGHT:
        found.append("the images are overexposed")
    return found


def _of_times(sequence: Sequence) -> list[str]:
    steps = np.diff(sequence.timestamps)
    found = []
    if len(steps) and not 1.0 <= sequence.fps <= 240.0:
        found.append(f"a frame rate of {sequence.fps:.3g} Hz is unlikely; check the unit of the time stamps (seconds)")
    gaps = int(np.count_nonzero(steps > 5 * np.median(steps))) if len(steps) else 0
    if gaps:
        found.append(f"{gaps} gap{'s' if gaps > 1 else ''} in time, where tracking may be lost")
    return found


def _of_camera(sequence: Sequence, fov: float) -> list[str]:
    camera, found = sequence.camera, []
    if not FIELD_OF_VIEW[0] < fov < FIELD_OF_VIEW[1]:
        found.append(f"a horizontal field of view of {fov:.0f} degrees is unlikely; check fx and the image width")
    if not 0.8 < camera.fx / camera.fy < 1.25:
        found.append(f"fx {camera.fx:.0f} and fy {camera.fy:.0f} differ much; are the images squeezed?")
    off = max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))
    if off > 0.2:
        found.append(f"the principal point lies {off:.0%} of the image off its middle; check cx and cy")
    return found


def _small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height = max(16, round(image.shape[0] * WIDTH / image.shape[1]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey, (WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)


def _flow(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float | None:
    """The median motion of corners in pixels, or None where there are too few."""
    corners = cv2.goodFeaturesToTrack(first, 200, 0.01, 7)
    if corners is None or len(corners) < 10:
        return None
    moved, status, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None)  # type: ignore[call-overload]
    followed = status.ravel() == 1
    if followed.sum() < 10:
        return None
    return float(np.median(np.linalg.norm((moved - corners).reshape(-1, 2)[followed], axis=1)))
