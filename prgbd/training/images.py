"""Frames of a recording at the network's size, decoded once, in memory or in a file."""

from __future__ import annotations

from collections.abc import Sequence as Many
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.types import PinholeCamera
from prgbd.core.undistortion import Undistorter
from prgbd.io.disk import allocated


def decode_frames(
    sequence: Sequence,
    frames: Many[int] | NDArray[np.int64],
    estimator: DepthEstimator,
    file: Path | None,
    camera: PinholeCamera | None = None,
) -> NDArray[np.uint8]:
    """Decode and resize frames.

    Args:
        sequence: The recording.
        frames: Positions in the recording.
        estimator: Says the size.
        file: Where to keep the images, as ``.npy``; None for memory.
        camera: The camera of the images by SLAM, whose distortion is removed; None removes none.

    Returns:
        (F, 3, h, w) uint8, in memory or mapped from the file.

    Raises:
        DiskError: If the disk has no room for the file.
    """
    height, width = estimator.input_size
    shape = (len(frames), 3, height, width)
    if file is None:
        images: NDArray[np.uint8] = np.empty(shape, np.uint8)
    else:
        images = allocated(file, shape, np.uint8)
    undistorter = Undistorter(camera or sequence.camera.undistorted())
    for row, frame in enumerate(frames):
        image = estimator.preprocess(undistorter.image(sequence.frame(int(frame)).image))
        images[row] = (image * 255).round_().clamp_(0, 255).byte().cpu().numpy()
    return images


def image_folder(count: int, input_size: tuple[int, int], memory_mb: int, out: Path) -> Path | None:
    """Return the folder in ``out`` for images that do not fit into memory, or None if they do.

    Args:
        count: Number of images of all recordings together.
        input_size: Their (height, width).
        memory_mb: What they may take in memory, MiB.
        out: Folder of the training.
    """
    height, width = input_size
    return out / "images" if count * 3 * height * width > memory_mb * 2**20 else None
