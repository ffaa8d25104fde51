"""The mapper in a thread beside the tracker."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from typing import Any

from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.mapping.backend import MappingBackend
from prgbd.plugins.slam.orb_gtsam.mapping.local_mapper import LocalMapper

# Seconds after which Python asks a thread for its interpreter lock. Both threads spend most of their time in compiled
# code without it, and each return from there would wait for Python's default of 5 ms while the other one is busy.
_SWITCH_INTERVAL = 2e-4


class ThreadedBackend(MappingBackend):
    """Maps keyframes in a thread, in the order in which they come, and each of them.

    Nothing is dropped: a keyframe that finds the queue full makes the tracker wait, which the statistics count.

    Args:
        mapper: The local mapper.
        watch: Gathers stage times.
        queue_size: Most keyframes that wait while one is being mapped. With 0 the tracker runs ahead by the frames up
            to the next keyframe and no further; each more lets it track in an older map.
    """

    def __init__(self, mapper: LocalMapper, watch: Stopwatch, queue_size: int) -> None:
        super().__init__(mapper, watch)
        self._size = queue_size
        self._jobs: deque[tuple[int, bool]] = deque()
        self._changed = threading.Condition()
        self._busy = False
        self._closing = False
        self._error: BaseException | None = None
        self._longest, self._waits, self._waited = 0, 0, 0.0
        self._interval = sys.getswitchinterval()
        sys.setswitchinterval(min(self._interval, _SWITCH_INTERVAL))
        self._thread = threading.Thread(target=self._work, name="mapper", daemon=True)
        self._thread.start()

    def is_idle(self) -> bool:
        """See ``MappingBackend.is_idle``."""
        with self._changed:
            return not self._busy and not self._jobs

    def insert_keyframe(self, k: int, *, local_mapping: bool = True) -> None:
        """See ``MappingBackend.insert_keyframe``; waits while the queue is full."""
        with self._changed:
            if not self._has_room():
                self._waits += 1
                start = time.perf_counter()
                self._changed.wait_for(lambda: self._has_room() or self._error is not None)
                self._waited += time.perf_counter() - start
            self._raise()
            self._jobs.append((k, local_mapping))
            self._longest = max(self._longest, len(self._jobs))
            self._changed.notify_all()

    def _has_room(self) -> bool:
        return len(self._jobs) + self._busy <= self._size

    def check(self) -> None:
        """See ``MappingBackend.check``."""
        with self._changed:
            self._raise()

    def drain(self) -> None:
        """See ``MappingBackend.drain``."""
        with self._changed:
            self._changed.wait_for(lambda: self._error is not None or not (self._busy or self._jobs))
            self._raise()

    def close(self) -> None:
        """See ``MappingBackend.close``; returns when the thread has ended, at the latest after one step of it."""
        if self._closing:
            return
        with self._changed:
            self._closing = True
            self._jobs.clear()
            self._changed.notify_all()
            if self._busy:
                self.mapper.map.steps.stop()
        self._thread.join()
        sys.setswitchinterval(self._interval)

    def statistics(self) -> dict[str, Any]:
        """See ``MappingBackend.statistics``: how often and long the tracker waited for the mapper."""
        return {
            "realtime": {
                "longest_queue": self._longest,
                "tracker_waits": self._waits,
                "tracker_waited_ms": round(1000.0 * self._waited, 1),
            }
        }

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        try:
            while (job := self._next()) is not None:
                self._run(*job)
        except BaseException as error:  # handed to the caller of track or finish as itself
            with self._changed:
                self._error = None if self._closing else error
                self._jobs.clear()
        finally:
            with self._changed:
                self._busy = False
                self._changed.notify_all()

    def _next(self) -> tuple[int, bool] | None:
        """Wait for a keyframe; None when there will be no more."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: bool(self._jobs) or self._closing)
            if self._closing:
                return None
            self._busy = True
            job = self._jobs.popleft()
            self._changed.notify_all()
            return job
