"""Frames of a recording, decoded in batches beside the network that works on them."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor

import torch

from prgbd.core.data import Sequence
from prgbd.core.types import Frame

_LOOK_AHEAD = 2
"""Batches that are decoded while the network works on another one."""

Batch = tuple[list[Frame], torch.Tensor | None]
"""Frames, and what they were prepared to for the network, if anything."""


def decoded(
    sequence: Sequence,
    size: int,
    device: torch.device,
    prepare: Callable[[list[Frame]], torch.Tensor] | None,
) -> Generator[Batch]:
    """Yield decoded batches; a thread of its own is ahead by a few where the network leaves a core to it.

    Args:
        sequence: The recording.
        size: Frames of a batch.
        device: Where the network works.
        prepare: Makes the frames of a batch to the network's input.
    """
    cores, threads = os.cpu_count() or 1, torch.get_num_threads()
    takes_all = device.type == "cpu" and threads >= cores
    # What the network leaves; where it leaves nothing, it waits, and all of its threads may decode.
    free = threads if takes_all else cores - threads if device.type == "cpu" else cores

    def decode(indices: range) -> Batch:
        frames = _frames(sequence, indices, free)
        return frames, None if prepare is None else prepare(frames)

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


def _frames(sequence: Sequence, indices: range, threads: int) -> list[Frame]:
    """Decode frames, by several threads where the recording allows it."""
    threads = min(threads, len(indices))
    if threads < 2 or not sequence.concurrent:
        return [sequence.frame(index) for index in indices]
    with ThreadPoolExecutor(threads, "decode") as pool:
        return list(pool.map(sequence.frame, indices))
