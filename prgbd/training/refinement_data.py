"""Samples of several sequences as batches: images at the network's size, cameras and pixels resized to match."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data import DataLoader, Dataset

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import DataError
from prgbd.core.refinement_batch import RefinementBatch
from prgbd.core.types import PinholeCamera, resize_pixels
from prgbd.training.images import decode_frames
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.sampling import EpochSampler, ResumableData
from prgbd.training.supervision import KeyframeSample, Supervision

_IMAGES_PER_SAMPLE = 3  # c, k1 and k2 pass through the network


@dataclass(frozen=True)
class SupervisedImages:
    """One sequence's samples with the decoded images that they need.

    Attributes:
        name: Of the sequence.
        supervision: The samples.
        camera: At the network's input size.
        frames: (F,) int64 ascending positions of the decoded frames in the sequence.
        images: (F, 3, h, w) uint8, in memory or mapped from a file.
        scale: Factor on SLAM's lengths.
    """

    name: str
    supervision: Supervision
    camera: PinholeCamera
    frames: NDArray[np.int64]
    images: NDArray[np.uint8]
    scale: float = 1.0

    def keyframe(self, index: int) -> NDArray[np.uint8]:
        """Return the image of a sample's own keyframe, (3, h, w)."""
        image: NDArray[np.uint8] = self.images[np.searchsorted(self.frames, self.supervision.samples[index].frames[0])]
        return image

    def sample(self, index: int) -> RefinementBatch:
        """Return a sample in tensors, at the network's input size and in the network's scale."""
        sample: KeyframeSample = self.supervision.samples[index]
        rows = np.searchsorted(self.frames, sample.frames)
        aTc, kTc = sample.aTc.copy(), sample.kTc.copy()
        aTc[:, :3, 3] *= self.scale
        kTc[:, :3, 3] *= self.scale
        return RefinementBatch(
            images=torch.from_numpy(np.array(self.images[rows])),
            K=torch.from_numpy(self.camera.K).float(),
            aTc=torch.from_numpy(aTc).float(),
            kTc=torch.from_numpy(kTc).float(),
            uv=torch.from_numpy(resized_pixels(sample.uv, self.supervision.camera, self.camera)),
            depth=torch.from_numpy(sample.depth * np.float32(self.scale)),
            mask=torch.ones(len(sample.point), dtype=torch.bool),
            seen_uv=torch.from_numpy(resized_pixels(sample.seen_uv, self.supervision.camera, self.camera)),
            seen_depth=torch.from_numpy(sample.seen_depth * np.float32(self.scale)),
            seen_mask=torch.ones(len(sample.seen_depth), dtype=torch.bool),
        )


def resized_pixels(uv: NDArray[np.float32], before: PinholeCamera, after: PinholeCamera) -> NDArray[np.float32]:
    """Move pixels (..., 2) from one image size of a camera to another."""
    scale = np.array([after.width / before.width, after.height / before.height])
    return np.asarray(resize_pixels(uv.astype(np.float64), scale), np.float32)


def decode_images(
    sequence: Sequence, supervision: Supervision, estimator: DepthEstimator, file: Path | None
) -> SupervisedImages:
    """Decode and resize every frame that the samples need, once.

    Args:
        sequence: The recording.
        supervision: Its samples.
        estimator: Says the size.
        file: Where to keep the images; None for memory.

    Raises:
        DataError: If SLAM's camera is not the recording's.
    """
    camera = supervision.camera
    if (camera.width, camera.height) != (sequence.camera.width, sequence.camera.height):
        raise DataError(
            f"SLAM worked on {camera.width}x{camera.height} images, but '{sequence.name}' has "
            f"{sequence.camera.width}x{sequence.camera.height}; refine on the recording that SLAM saw."
        )
    frames = needed_frames(supervision)
    height, width = estimator.input_size
    images = decode_frames(sequence, frames, estimator, file, camera)
    return SupervisedImages(sequence.name, supervision, camera.resized(width, height), frames, images)


def needed_frames(supervision: Supervision) -> NDArray[np.int64]:
    """Positions of all frames that the samples name, ascending."""
    return np.unique(np.concatenate([s.frames for s in supervision.samples] or [np.zeros(0, np.int64)]))


def collate(samples: Many[RefinementBatch]) -> RefinementBatch:
    """Stack samples, padding their points to the longest."""

    def padded(name: str, dim: int) -> Tensor:
        tensors = [getattr(s, name).movedim(dim, 0) for s in samples]
        return pad_sequence(tensors, batch_first=True).movedim(1, dim + 1)

    return RefinementBatch(
        images=torch.stack([s.images for s in samples]),
        K=torch.stack([s.K for s in samples]),
        aTc=torch.stack([s.aTc for s in samples]),
        kTc=torch.stack([s.kTc for s in samples]),
        uv=padded("uv", 1),
        depth=padded("depth", 1),
        mask=padded("mask", 0),
        seen_uv=padded("seen_uv", 0),
        seen_depth=padded("seen_depth", 0),
        seen_mask=padded("seen_mask", 0),
    )


def split_held_out(count: int, fraction: float) -> tuple[list[int], list[int]]:
    """Split ``count`` samples into training and held-out ones, every n-th being held out.

    With a fraction of 0, or a single sample, the training samples stand in for the held-out ones.
    """
    everything = list(range(count))
    if fraction <= 0 or count < 2:
        return everything, everything
    every = round(1 / fraction)
    held_out = everything[every // 2 :: every] or [count // 2]
    return [i for i in everything if i not in set(held_out)], held_out


class _Samples(Dataset[RefinementBatch]):
    """Chosen samples of all sequences."""

    def __init__(self, sources: Many[SupervisedImages], chosen: Many[tuple[int, int]]) -> None:
        self.sources = sources
        self.chosen = chosen

    def __len__(self) -> int:
        return len(self.chosen)

    def __getitem__(self, index: int) -> RefinementBatch:
        source, sample = self.chosen[index]
        return self.sources[source].sample(sample)


class RefinementData(ResumableData):
    """The samples of several sequences, split into training and held-out keyframes.

    Args:
        sources: Sequences with decoded images, all at one size.
        settings: Batch size, workers, seed and split.

    Attributes:
        train_samples: Number of samples that train.
        held_out_samples: Number of samples that measure the label-free criterion.
        held_out_frames: Recording and frame of each of those.
    """

    def __init__(self, sources: Many[SupervisedImages], settings: RefinementSettings) -> None:
        super().__init__()
        self._settings = settings
        everything = [(s, i) for s, source in enumerate(sources) for i in range(len(source.supervision.samples))]
        train, held_out = split_held_out(len(everything), settings.val_fraction)
        self._train = _Samples(sources, [everything[i] for i in train])
        self._held_out = _Samples(sources, [everything[i] for i in held_out])
        self.train_samples, self.held_out_samples = len(train), len(held_out)
        self.held_out_frames = [
            (sources[s].name, sources[s].supervision.samples[i].current) for s, i in self._held_out.chosen
        ]

    def mixed_keyframes(self) -> Iterator[Tensor]:
        """Yield the keyframes that train, (B, 3, H, W) float32 in [0, 1], as many at a time as the network trains with.

        Every batch is spread over the recordings, as shuffled ones are: neighbours vary less than they do.
        """
        chosen = self._train.chosen
        batches = max(1, len(chosen) // (_IMAGES_PER_SAMPLE * self._settings.samples_per_step))
        for first in range(batches):
            images = [self._train.sources[s].keyframe(i) for s, i in chosen[first::batches]]
            yield torch.from_numpy(np.stack(images)).float() / 255

    def _loader(self, samples: _Samples, sampler: EpochSampler | None) -> DataLoader[RefinementBatch]:
        workers = self._settings.workers
        return DataLoader(
            samples,
            batch_size=self._settings.samples_per_step,
            sampler=sampler,
            collate_fn=collate,
            # Without one, making an iterator draws from the global generator.
            generator=torch.Generator(),
            num_workers=workers,
            persistent_workers=workers > 0,
        )

    def train_dataloader(self) -> DataLoader[RefinementBatch]:
        """Shuffled by the seed, in every epoch otherwise."""
        settings = self._settings
        return self._loader(self._train, self.sampler(len(self._train), settings.seed, settings.samples_per_step))

    def val_dataloader(self) -> DataLoader[RefinementBatch]:
        """The held-out keyframes in order, all of them in every process."""
        return self._loader(self._held_out, None)
