"""Depth maps as pictures: predictions of two loops beside image and truth, in one colour scale, and their errors."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.report.reading import DepthSamples

UNKNOWN = (128, 134, 143)
ERROR_LIMIT = 0.5  # relative error, or predicted deviation of log depth, at the end of the colour scale
DEPTH_MAP, ERROR_MAP = "magma_r", "inferno"


@dataclass(frozen=True)
class Prediction:
    """One predicted depth map.

    Attributes:
        label: Name of the loop.
        picture: (H, W, 3) uint8.
        error_picture: (H, W, 3) uint8 of the relative error, or None without truth.
        abs_rel: Mean relative error after median scaling, or None without truth.
        sigma_picture: (H, W, 3) uint8 of the predicted deviation of log depth, or None where there is none.
    """

    label: str
    picture: NDArray[np.uint8]
    error_picture: NDArray[np.uint8] | None = None
    abs_rel: float | None = None
    sigma_picture: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class DepthRow:
    """One frame with its image, its truth, and the predictions of some loops, in one colour scale.

    Attributes:
        sequence: Name of the sequence.
        frame: Frame number.
        image: (H, W, 3) uint8.
        truth: (H, W, 3) uint8, or None.
        predictions: One per loop.
        near: Depth at the near end of the colour scale.
        far: Depth at the far end.
    """

    sequence: str
    frame: int
    image: NDArray[np.uint8]
    truth: NDArray[np.uint8] | None
    predictions: list[Prediction]
    near: float
    far: float

    @property
    def has_sigma(self) -> bool:
        """Whether a prediction says how wrong it may be."""
        return any(prediction.sigma_picture is not None for prediction in self.predictions)


def depth_rows(loops: list[tuple[str, DepthSamples]], most: int = 4) -> list[DepthRow]:
    """Put the samples of some loops side by side, frame by frame; frames that not all loops have are left out."""
    if not loops:
        return []
    common = [key for key in loops[0][1].keys if all(key in samples.keys for _, samples in loops[1:])]
    chosen = [common[i] for i in np.unique(np.linspace(0, len(common) - 1, min(most, len(common))).astype(int))]
    return [_row(loops, key) for key in chosen]


def _row(loops: list[tuple[str, DepthSamples]], key: tuple[str, int]) -> DepthRow:
    at = [samples.keys.index(key) for _, samples in loops]
    depths = [samples.depth[i] for (_, samples), i in zip(loops, at, strict=True)]
    truths = [s.truth[i] for (_, s), i in zip(loops, at, strict=True) if s.truth is not None]
    truth = next((t for t in truths if (t > 0).any()), None)
    depths = _to_one_scale(depths, depths[-1] if truth is None else truth)
    # The colours fit the last network: those of the first, which may be far off, would leave it a part of the scale.
    refined = depths[-1][np.isfinite(depths[-1]) & (depths[-1] > 0)]
    near, far = np.percentile(refined, [2, 98]) if len(refined) else (1.0, 2.0)
    far = max(far, near * 1.05)
    sigmas = [None if samples.sigma is None else samples.sigma[i] for (_, samples), i in zip(loops, at, strict=True)]
    predictions = [
        _prediction(name, depth, sigma, truth, near, far)
        for (name, _), depth, sigma in zip(loops, depths, sigmas, strict=True)
    ]
    picture = None if truth is None else depth_picture(thicken(truth), near, far)
    return DepthRow(key[0], key[1], loops[0][1].images[at[0]], picture, predictions, float(near), float(far))


def _prediction(
    label: str,
    depth: NDArray[np.float32],
    sigma: NDArray[np.float32] | None,
    truth: NDArray[np.float32] | None,
    near: float,
    far: float,
) -> Prediction:
    picture = depth_picture(depth, near, far)
    doubt = None if sigma is None else error_picture(sigma)
    if truth is None:
        return Prediction(label, picture, sigma_picture=doubt)
    error = relative_error(depth, truth)
    return Prediction(label, picture, error_picture(error), float(np.nanmean(error)), doubt)


def _to_one_scale(depths: list[NDArray[np.float32]], reference: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Scale each map by the ratio of its median to the reference's, where both are known."""
    scaled = []
    for depth in depths:
        both = (reference > 0) & np.isfinite(depth) & (depth > 0)
        ratio = np.median(reference[both]) / np.median(depth[both]) if both.any() else 1.0
        scaled.append((depth * ratio).astype(np.float32))
    return scaled


def relative_error(depth: NDArray[np.float32], truth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return |depth - truth| / truth, NaN where the truth is unknown, (H, W)."""
    known = (truth > 0) & np.isfinite(depth)
    return np.where(known, np.abs(depth - truth) / np.where(known, truth, 1), np.nan).astype(np.float32)


def thicken(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Grow sparse points (0 is nothing) so that they can be seen; dense maps stay as they are."""
    if np.count_nonzero(values) > 0.25 * values.size:
        return values
    import cv2

    return np.asarray(cv2.dilate(values, np.ones((5, 5), np.uint8)), np.float32)


def depth_picture(depth: NDArray[np.float32], near: float, far: float) -> NDArray[np.uint8]:
    """Colour depth on a logarithmic scale, near bright and far dark; unknown depth is grey."""
    known = np.isfinite(depth) & (depth > 0)
    level = np.log(np.where(known, depth, near) / near) / np.log(far / near)
    return _coloured(level, known, DEPTH_MAP)


def error_picture(error: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colour relative errors from 0 (dark) to ``ERROR_LIMIT`` (bright); unknown is grey."""
    grown = thicken(np.where(np.isfinite(error), error + 1e-6, 0).astype(np.float32))
    return _coloured(grown / ERROR_LIMIT, grown > 0, ERROR_MAP)


def _coloured(level: NDArray[np.floating], known: NDArray[np.bool_], name: str) -> NDArray[np.uint8]:
    from matplotlib import colormaps

    out = (colormaps[name](np.clip(level, 0, 1))[..., :3] * 255).astype(np.uint8)
    out[~known] = UNKNOWN
    return out


def gradient(name: str, steps: int = 9) -> str:
    """Return a colour map as a CSS gradient."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return f"linear-gradient(90deg,{','.join(to_hex(colormaps[name](i / (steps - 1))) for i in range(steps))})"


def to_jpeg(picture: NDArray[np.uint8], width: int, quality: int = 84) -> bytes:
    """Encode an RGB picture as JPEG, no wider than ``width`` pixels."""
    import cv2

    if picture.shape[1] > width:
        height = max(1, round(picture.shape[0] * width / picture.shape[1]))
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes()


def jpeg_address(picture: NDArray[np.uint8], width: int) -> str:
    """Return an RGB picture as an address for HTML that holds it all."""
    return f"data:image/jpeg;base64,{base64.b64encode(to_jpeg(picture, width)).decode()}"
