"""The mapper's side of the system: what happens once a frame has become a keyframe."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.mapping.local_mapper import LocalMapper


class MappingBackend:
    """Maps each keyframe in step with the tracker, so that equal input gives equal output.

    Attributes:
        mapper: Works on the map around a keyframe.
        after_keyframe: Called in this order with each keyframe once it has been mapped (loop closing, keyframe
            database, ...), on the mapper's side and without ``Map.lock``: whoever reads or changes the map takes it.

    Args:
        mapper: The local mapper.
        watch: Gathers stage times.
    """

    def __init__(self, mapper: LocalMapper, watch: Stopwatch) -> None:
        self.mapper, self.watch = mapper, watch
        self.after_keyframe: list[Callable[[int], None]] = []

    def is_idle(self) -> bool:
        """Whether a keyframe would be mapped at once (ORB-SLAM2's ``AcceptKeyFrames``)."""
        return True

    def insert_keyframe(self, k: int, *, local_mapping: bool = True) -> None:
        """Hand over keyframe ``k``, which the map already holds.

        The caller must not hold ``Map.lock``, as this may wait for the mapper.

        Args:
            k: The keyframe.
            local_mapping: Whether the local mapper works on it; the first keyframes of a map only pass the callbacks.
        """
        self._run(k, local_mapping)

    def _run(self, k: int, local_mapping: bool) -> None:
        with self.watch("mapping"):
            if local_mapping:
                self.mapper.process(k)
        for callback in self.after_keyframe:
            callback(k)

    def check(self) -> None:
        """Raise the exception that stopped the mapper, if one did."""

    def drain(self) -> None:
        """Wait until all that was handed over is mapped; raises what stopped the mapper, if something did."""

    def close(self) -> None:
        """Stop working, in the middle of a keyframe if need be."""

    def statistics(self) -> dict[str, Any]:
        """Return what the result tells of the mapper's work beside the tracker; nothing where it works in step."""
        return {}
