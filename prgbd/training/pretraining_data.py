"""Triplets of neighbouring frames at the network's size, with frames that hardly move left out."""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import DataError
from prgbd.core.types import PinholeCamera
from prgbd.training.images import decode_frames
from prgbd.training.pretraining_settings import PretrainingSettings
from prgbd.training.refinement_data import split_held_out
from prgbd.training.sampling import EpochSampler, ResumableData

_MOTION_WIDTH = 64


class Triplets(NamedTuple):
    """A batch; a single sample is the same without the first axis.

    Attributes:
        images: (B, 3, 3, H, W) uint8, or float in [0, 1] once on the device: the target, the earlier, the later frame.
        K: (B, 3, 3) float32 intrinsics at the size of the images, pixels.
    """

    images: Tensor
    K: Tensor


@dataclass(frozen=True)
class DecodedSequence:
    """One recording at the network's input size.

    Attributes:
        name: Of the recording.
        camera: At the network's input size.
        images: (N, 3, h, w) uint8, in memory or mapped from a file.
        targets: Positions of the frames that train.
        still: Number of frames left out because they hardly move.
    """

    name: str
    camera: PinholeCamera
    images: NDArray[np.uint8]
    targets: NDArray[np.int64]
    still: int


def decode(
    sequence: Sequence,
    estimator: DepthEstimator,
    settings: PretrainingSettings,
    file: Path | None = None,
) -> DecodedSequence:
    """Decode and resize a recording once, and find the frames that move.

    Args:
        sequence: The recording.
        estimator: Says the size.
        settings: ``frame_gap`` and ``min_motion``.
        file: Where to keep the images; None for memory.

    Raises:
        DataError: If the recording is shorter than a triplet.
    """
    gap = settings.frame_gap
    if len(sequence) < 2 * gap + 1:
        raise DataError(
            f"'{sequence.name}' has {len(sequence)} frames, too few for triplets {gap} frames apart; use a longer "
            "recording or a smaller pretraining.frame_gap."
        )
    height, width = estimator.input_size
    images = decode_frames(sequence, range(len(sequence)), estimator, file)
    inner = np.arange(gap, len(sequence) - gap)
    moved = image_motion(images, gap)
    moving = (moved[inner - gap] >= settings.min_motion) & (moved[inner] >= settings.min_motion)
    return DecodedSequence(
        sequence.name, sequence.camera.resized(width, height), images, inner[moving], int((~moving).sum())
    )


def image_motion(images: NDArray[np.uint8], gap: int) -> NDArray[np.float64]:
    """Mean absolute difference between every image and the one ``gap`` later, grey levels, (N - gap,).

    Measured at a width of 64 pixels, where image noise averages out.

    Args:
        images: (N, 3, H, W) uint8.
        gap: Frames.
    """
    height, width = images.shape[2:]
    size = (_MOTION_WIDTH, max(1, round(height * _MOTION_WIDTH / width)))
    small = np.stack(
        [cv2.resize(image.mean(axis=0, dtype=np.float32), size, interpolation=cv2.INTER_AREA) for image in images]
    )
    return np.abs(small[gap:] - small[:-gap]).mean(axis=(1, 2), dtype=np.float64)


class _TripletDataset(Dataset[Triplets]):
    def __init__(self, sources: Many[DecodedSequence], chosen: Many[tuple[int, int]], gap: int) -> None:
        self._sources, self._chosen, self._gap = sources, chosen, gap

    def __len__(self) -> int:
        return len(self._chosen)

    def __getitem__(self, index: int) -> Triplets:
        number, frame = self._chosen[index]
        source = self._sources[number]
        images = np.array(source.images[[frame, frame - self._gap, frame + self._gap]])
        return Triplets(torch.from_numpy(images), torch.from_numpy(source.camera.K).float())


class PretrainingData(ResumableData):
    """The triplets of several recordings, split into training and held-out ones.

    Args:
        sources: Decoded recordings, all at one size.
        settings: Batch size, workers, seed and split.

    Raises:
        DataError: If no frame moves.
    """

    def __init__(self, sources: Many[DecodedSequence], settings: PretrainingSettings) -> None:
        super().__init__()
        self._settings = settings
        everything = [(s, int(frame)) for s, source in enumerate(sources) for frame in source.targets]
        if not everything:
            raise DataError(
                f"None of {sum(s.still for s in sources)} frames moves by pretraining.min_motion="
                f"{settings.min_motion:g} grey levels; record a moving camera, or raise pretraining.frame_gap."
            )
        train, held_out = split_held_out(len(everything), settings.val_fraction)
        self._train, self._held_out = (
            _TripletDataset(sources, [everything[i] for i in part], settings.frame_gap) for part in (train, held_out)
        )
        self.train_samples, self.held_out_samples = len(train), len(held_out)

    def _loader(self, samples: _TripletDataset, sampler: EpochSampler | None) -> DataLoader[Triplets]:
        workers = self._settings.workers
        return DataLoader(
            samples,
            batch_size=self._batch_size(samples),
            sampler=sampler,
            # A last batch of one or two would spoil the statistics of batch normalisation.
            drop_last=sampler is not None,
            # Without one, making an iterator draws from the global generator, before the first epoch or after its seed.
            generator=torch.Generator(),
            num_workers=workers,
            persistent_workers=workers > 0,
        )

    def _batch_size(self, samples: _TripletDataset) -> int:
        processes = 1 if self.trainer is None else self.trainer.world_size
        return min(self._settings.batch_size, -(-len(samples) // processes))

    def train_dataloader(self) -> DataLoader[Triplets]:
        """Shuffled by the seed, in every epoch otherwise."""
        batch_size = self._batch_size(self._train)
        return self._loader(self._train, self.sampler(len(self._train), self._settings.seed, batch_size))

    def val_dataloader(self) -> DataLoader[Triplets]:
        """The held-out triplets in order, all of them in every process."""
        return self._loader(self._held_out, None)
