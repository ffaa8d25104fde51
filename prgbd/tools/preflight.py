"""A look at a recording before a run: the mistakes that most users of such systems make with their own data."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import PrgbdError
from prgbd.plugins.data.focal_length import Pair, fit_focal_length, tracked_pair
from prgbd.plugins.data.image_motion import WIDTH, Turning, followed, small, turning

PLACES = 10  # in the recording that are looked at
ENOUGH = 4  # places that are looked at however long it takes
SECONDS = 1.2  # of computing, after which no further place is
STILL = 0.3  # pixels of median flow (of 320) below which nothing moves
FAST = 40.0  # above which features are hard to follow
SAME = 0.05  # mean grey levels of difference below which two frames are one
NEARLY_SAME = 0.5  # the same after compression, where nothing moves either
MANY = 0.25  # of the neighbouring frames are the same picture: every third frame or more is a repeated one
REPEATED = 0.1  # of the motion to the next frame: a frame that moves less is a repeated one
BLACK, DARK, BRIGHT = 5.0, 30.0, 225.0  # mean grey levels
LARGE = 2.5e6  # pixels of an image: more than Full HD
FIELD_OF_VIEW = (25.0, 130.0)  # degrees, horizontal
FAR = 25.0  # pixels of motion between the frames that a rotation is fitted to, at most 10 frames apart
TURNS = 0.06  # of the motion may be left over, at four of five places, where the camera only turns
FACTORS = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8)  # on the focal length
GAIN, AGREEMENT = 13.0, 0.65  # of another focal length's fit to pairs of images, for it to be said
OFF = 0.08  # relative difference of that focal length; a finer one is not measured reliably
FEATURES, SMALL = 1000, 3e4  # that SLAM systems look for in an image; pixels of an image that has no room for them
BETTER, BETTER_TURNING = 0.6, 0.8  # of the given focal length's left-over that another must reach


@dataclass
class _Look:
    """What was seen at all places together."""

    flows: list[float] = field(default_factory=list)
    differences: list[float] = field(default_factory=list)
    levels: list[float] = field(default_factory=list)
    turnings: list[Turning] = field(default_factory=list)
    repeated: int = 0


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
    """Look at motion, duplicates, exposure, frame rate and calibration of a recording, at a few places of it.

    Frames that cannot be read are left out: the run itself names them.
    """
    look = _Look()
    begin = time.process_time()
    for start in _places(sequence):
        if len(look.levels) >= ENOUGH and time.process_time() - begin > SECONDS:
            break
        try:
            _look_at(sequence, start, look)
        except PrgbdError:
            continue
    camera = sequence.camera
    fov = float(np.degrees(2 * np.arctan(camera.width / (2 * camera.fx))))
    motion = float(np.median(look.flows)) * camera.width / WIDTH if look.flows else None
    facts = [f"{len(sequence)} frames at {sequence.fps:.1f} Hz", f"field of view {fov:.0f} degrees"]
    facts += sequence.remarks
    if motion is not None:
        facts.append(f"motion {motion:.1f} pixels a frame")
    if look.levels:
        facts.append(f"brightness {np.mean(look.levels):.0f} of 255")
    warnings = (*_of_images(look), *_of_turning(sequence, look), *_of_times(sequence), *_of_camera(sequence, fov))
    return Preflight(", ".join(facts), warnings)


def _places(sequence: Sequence) -> list[int]:
    """Return the frames that are looked at: every third place first, so that few of them are spread as well."""
    places = np.unique(np.linspace(0, max(0, len(sequence) - 2), PLACES).astype(int))[: len(sequence) - 1]
    return [int(place) for first in range(3) for place in places[first::3]]


def _look_at(sequence: Sequence, start: int, look: _Look) -> None:
    """Compare a frame with the two behind it, and with one that the picture has moved further in."""
    first, second = (small(sequence.frame(index).image) for index in (start, start + 1))
    look.levels.append(float(first.mean()))
    look.differences.append(float(cv2.absdiff(first, second).mean()))
    pair = followed(first, second)
    if pair is None:
        return
    motion = _length(pair)
    if start + 2 < len(sequence):  # where every frame comes twice, one of the two pairs differs
        third = small(sequence.frame(start + 2).image)
        look.differences.append(float(cv2.absdiff(second, third).mean()))
        following = followed(second, third)
        low, high = sorted((motion, motion if following is None else _length(following)))
        look.repeated += low < REPEATED * high and high > STILL
        motion = high
    look.flows.append(motion)
    behind = start + int(np.clip(round(FAR / max(look.flows[-1], STILL)), 1, 10))
    if behind > start + 1 and behind < len(sequence):
        pair = followed(first, small(sequence.frame(behind).image))
    if pair is not None and _length(pair) > 10 * STILL:
        look.turnings.append(turning(*pair, sequence.camera, FACTORS))


def _length(pair: tuple[NDArray[np.float32], NDArray[np.float32]]) -> float:
    return float(np.median(np.linalg.norm(pair[1] - pair[0], axis=1)))


def _of_images(look: _Look) -> list[str]:
    found = []
    level = float(np.mean(look.levels)) if look.levels else 0.5 * (DARK + BRIGHT)
    if level < BLACK:
        return ["the images are black; choose another part (data.start, data.stop) or check the file"]
    same, pairs = sum(difference < SAME for difference in look.differences), len(look.differences)
    frozen = bool(pairs) and np.median(look.differences) < NEARLY_SAME and max(look.flows, default=0.0) < STILL / 10
    if (same and same == pairs) or frozen:
        found.append("the picture is frozen, every frame is the same; choose another part (data.start, data.stop)")
    elif same or 2 * look.repeated > len(look.flows):
        same = max(same, look.repeated)
        many = same >= MANY * pairs
        mend = "; set data.step=2 or convert it anew" if many else ": some frames are repeated, which does little harm"
        found.append(f"{same} of {pairs} neighbouring frames are the same picture{mend}")
    elif look.flows and np.median(look.flows) < STILL:
        found.append("hardly anything moves, so nothing can be triangulated; choose another part or raise data.step")
    if look.flows and np.median(look.flows) > FAST:
        found.append("the picture moves fast; use a higher frame rate or a smaller data.step")
    if look.levels and len(look.flows) < 0.5 * len(look.levels):
        found.append("there is too little texture to follow in most frames")
    if level < DARK:
        found.append("the images are very dark")
    if level > BRIGHT:
        found.append("the images are overexposed")
    return found


def _of_turning(sequence: Sequence, look: _Look) -> list[str]:
    """A camera that only turns shows no depth, but its focal length; one that also turns shows it less sharply."""
    if len(look.turnings) < ENOUGH:
        return []
    left = np.array([seen.left_over for seen in look.turnings])
    found = []
    only = bool(np.quantile(left[:, FACTORS.index(1.0)], 0.8) < TURNS)
    if only:
        sensor = sequence.frame(0).depth is not None
        mend = "the sensor's is needed (slam.mode=rgbd)" if sensor else "move it sideways, or give depth=ID"
        found.append(f"the camera hardly moves, it only turns, which shows no depth; {mend}")
    fitting = _coarse_focal_length(sequence, left, only) or _fine_focal_length(sequence)
    if fitting is not None:
        f = sequence.camera.fx
        found.append(
            f"the way it turns fits a focal length of about {fitting:.0f} pixels better than {f:.0f}; "
            "check the calibration"
        )
    return found


def _coarse_focal_length(sequence: Sequence, left: NDArray[np.float64], only: bool) -> float | None:
    """Return a focal length by which rotations alone explain the motion much better than by the given one, or None.

    Args:
        sequence: The recording.
        left: (N, F) what the best rotation leaves of the motion with every factor.
        only: Whether the camera only turns.
    """
    fits = left.min(axis=1) < 2.5 * TURNS
    if fits.sum() < ENOUGH:
        return None
    given = FACTORS.index(1.0)
    turns = left[fits].mean(axis=0)
    best = int(turns.argmin())
    better = turns[best] < (BETTER_TURNING if only else BETTER) * turns[given]
    # A wall that one slides along looks like turning with an ever longer lens: a best one in between is asked for.
    if better and 0 < best < len(FACTORS) - 1 and abs(best - given) > 1:
        return FACTORS[best] * sequence.camera.fx
    return None


def _fine_focal_length(sequence: Sequence) -> float | None:
    """Return a focal length by which the motion of a turning camera fits clearly better than by the given one."""
    pairs: list[Pair] = []
    begin = time.process_time()
    for start in _places(sequence):
        if time.process_time() - begin > SECONDS and len(pairs) >= ENOUGH:
            break
        with contextlib.suppress(PrgbdError):
            pair = tracked_pair(lambda index: sequence.frame(index).image, start, len(sequence))
            pairs += [] if pair is None else [pair]
    fit = fit_focal_length(pairs, sequence.camera)
    if fit is None or fit.gain < GAIN or fit.agreement < AGREEMENT or abs(fit.factor - 1) < OFF:
        return None
    return fit.factor * sequence.camera.fx


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
        given = "check fx and the image width, and that a field of view is given in degrees"
        found.append(f"a horizontal field of view of {fov:.3g} degrees is unlikely; {given}")
    if camera.width * camera.height > LARGE:
        found.append(
            f"images of {camera.width}x{camera.height} pixels take long and gain little; shrink them (data.width=1280 "
            "for a video)"
        )
    if camera.width * camera.height < SMALL:
        found.append(
            f"images of {camera.width}x{camera.height} are too small for {FEATURES} features, so tracking may never "
            "begin; use larger images"
        )
    if not 0.8 < camera.fx / camera.fy < 1.25:
        found.append(f"fx {camera.fx:.0f} and fy {camera.fy:.0f} differ much; are the images squeezed?")
    off = max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))
    if off > 0.15:
        found.append(f"the principal point lies {off:.0%} of the image off its middle; check cx and cy")
    return found
