"""Frames of a recording, decoded in batches beside the network that works on them."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch
from numpy.typing import NDArray

from prgbd.core.data import Sequence

_LOOK_AHEAD = 2
"""Batches that are decoded while the network works on another one."""

Batch = tuple[range, list[NDArray[np.uint8]], torch.Tensor | None]
"""Frames, their images, and what they were prepared to for the network, if anything."""


def decoded(
    sequence: Sequence,
    size: int,
    device: torch.device,
    prepare: Callable[[list[NDArray[np.uint8]]], torch.Tensor] | None,
) -> Generator[Batch]:
    """Yield decoded batches; a thread of its own is ahead by a few where the network leaves a core to it.

    Args:
        sequence: The recording.
        size: Frames of a batch.
        device: Where the network works.
        prepare: Makes images (H, W, 3) of a batch to the network's input.
    """
    cores, threads = os.cpu_count() or 1, torch.get_num_threads()
    takes_all = device.type == "cpu" and threads >= cores
    # What the network leaves; where it leaves nothing, it waits, and all of its threads may decode.
    free = threads if takes_all else cores - threads if device.type == "cpu" else cores

    def decode(indices: range) -> Batch:
        images = _images(sequence, indices, free)
        return indices, images, None if prepare is None else prepare(images)

    count = len(sequence)
    batches = [range(start, min(start + size, count)) for start in range(0, count, size)]
    if takes_all:
        # A thread beside convolutions that take every core makes all of them wait for the one it sits on.
        yield from map(decode, batches)
        return
    with ThreadPoolExecutor(1, "decode") as thread:
        ahead: deque[Future[Batch]] = deque()
        for indices in batches:
            ahead.append(thread.submit(decode, indices))
            if len(ahead) > _LOOK_AHEAD:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


def _images(sequence: Sequence, indices: range, threads: int) -> list[NDArray[np.uint8]]:
    """Decode frames, by several threads where the recording allows it."""
    threads = min(threads, len(indices))
    if threads < 2 or not sequence.concurrent:
        return [sequence.frame(index).image for index in indices]
    with ThreadPoolExecutor(threads, "decode") as pool:
        return [frame.image for frame in pool.map(sequence.frame, indices)]
