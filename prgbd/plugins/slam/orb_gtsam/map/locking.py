"""The lock of the map: fair between tracker and mapper, and a way to stop the mapper between two steps."""

from __future__ import annotations

import threading
from collections import deque
from types import TracebackType

# The lock is on its way to the thread that has waited longest.
_NOBODY_ELSE = -1


class FairLock:
    """A reentrant lock that threads get in the order in which they asked for it.

    ``threading.RLock`` lets a thread that releases and asks again at once (the mapper, between two of its many short
    steps) overtake one that has been waiting (the tracker) for as long as it likes. Here the wait is one step.
    """

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._queue: deque[threading.Lock] = deque()
        self._owner: int | None = None
        self._depth = 0

    def acquire(self) -> None:
        """Wait for the lock; the owner may take it again."""
        me = threading.get_ident()
        with self._mutex:
            if self._owner is None or self._owner == me:
                self._owner = me
                self._depth += 1
                return
            turn = threading.Lock()
            turn.acquire()
            self._queue.append(turn)
        try:
            turn.acquire()
        except BaseException:
            self._step_back(turn)
            raise
        with self._mutex:
            # The one who released has handed the lock over, so nobody could take it in between.
            self._owner, self._depth = me, 1

    def release(self) -> None:
        """Give the lock to who waits longest.

        Raises:
            RuntimeError: If the thread does not hold it.
        """
        with self._mutex:
            if self._owner != threading.get_ident():
                raise RuntimeError("The lock of the map was released by a thread that does not hold it.")
            self._depth -= 1
            if self._depth == 0:
                self._hand_over()

    def _hand_over(self) -> None:
        self._owner = _NOBODY_ELSE if self._queue else None
        if self._queue:
            self._queue.popleft().release()

    def _step_back(self, turn: threading.Lock) -> None:
        """Stop waiting: the wait was interrupted (Ctrl-C)."""
        with self._mutex:
            if turn in self._queue:
                self._queue.remove(turn)
            else:
                self._hand_over()

    def __enter__(self) -> FairLock:
        self.acquire()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None
    ) -> None:
        self.release()


class MappingStopped(Exception):
    """The mapper's side was told to stop in the middle of a keyframe."""


class StepLock:
    """A lock for work in many short steps that can be told to stop between two of them."""

    def __init__(self, lock: FairLock) -> None:
        self._lock = lock
        self.stopped = False

    def stop(self) -> None:
        """Let the work, which may be going on in another thread, end before its next step by ``MappingStopped``."""
        self.stopped = True

    def __enter__(self) -> None:
        if self.stopped:
            raise MappingStopped
        self._lock.acquire()

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None
    ) -> None:
        self._lock.release()
