"""The fair lock of the map."""

from __future__ import annotations

import threading
import time

import pytest

from prgbd.plugins.slam.orb_gtsam.map.locking import FairLock, MappingStopped, StepLock


def test_only_one_thread_is_inside_and_the_owner_may_come_again() -> None:
    lock, inside, most, total = FairLock(), 0, 0, 0

    def work() -> None:
        nonlocal inside, most, total
        for _ in range(300):
            with lock, lock:
                inside += 1
                most = max(most, inside)
                before = total
                time.sleep(0)
                total = before + 1
                inside -= 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert (most, total) == (1, 1200)


def test_a_thread_that_asks_again_at_once_does_not_overtake_one_that_waits() -> None:
    lock, done, turns = FairLock(), threading.Event(), 0

    def greedy() -> None:
        nonlocal turns
        while not done.is_set():
            with lock:
                turns += 1
                time.sleep(0.002)

    thread = threading.Thread(target=greedy)
    thread.start()
    while not turns:
        time.sleep(0.001)
    waits = []
    for _ in range(20):
        before = turns
        with lock:
            waits.append(turns - before)
        time.sleep(0.001)
    done.set()
    thread.join(20)
    # It sees the end of the turn that it came into, at most.
    assert max(waits) <= 1


def test_a_stranger_cannot_give_the_lock_back() -> None:
    lock = FairLock()
    with lock:
        thread_error: list[BaseException] = []

        def release() -> None:
            try:
                lock.release()
            except RuntimeError as error:
                thread_error.append(error)

        thread = threading.Thread(target=release)
        thread.start()
        thread.join(20)
        assert "does not hold it" in str(thread_error[0])
    with pytest.raises(RuntimeError, match="does not hold it"):
        lock.release()


def test_work_in_steps_ends_before_the_next_step_and_leaves_the_lock_free() -> None:
    lock = FairLock()
    steps = StepLock(lock)
    with steps, steps, lock:
        steps.stop()  # what has begun is finished
    with pytest.raises(MappingStopped), steps:
        raise AssertionError("a step was begun after the stop")
    entered = threading.Event()

    def enter() -> None:
        with lock:
            entered.set()

    threading.Thread(target=enter).start()
    assert entered.wait(5)


def test_a_step_that_fails_gives_the_lock_back() -> None:
    lock = FairLock()
    with pytest.raises(ZeroDivisionError), StepLock(lock):
        raise ZeroDivisionError
    with pytest.raises(RuntimeError, match="does not hold"):
        lock.release()
