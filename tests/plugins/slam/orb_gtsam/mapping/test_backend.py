"""The way of a keyframe through the mapper's side."""

from __future__ import annotations

import pytest

from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.mapping.backend import MappingBackend


class Recorder:
    """Stands in for the local mapper."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, int]] = []

    def process(self, k: int) -> None:
        if k < 0:
            raise ZeroDivisionError("broken")
        self.calls.append(("map", k))

    def then(self, name: str):
        return lambda k: self.calls.append((name, k))


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def backend(recorder) -> MappingBackend:
    backend = MappingBackend(recorder, Stopwatch())
    backend.after_keyframe += [recorder.then("close loops"), recorder.then("index")]
    return backend


def test_a_keyframe_is_mapped_before_the_callbacks_have_it(backend, recorder) -> None:
    backend.insert_keyframe(3)
    backend.insert_keyframe(4)
    assert recorder.calls == [(step, k) for k in (3, 4) for step in ("map", "close loops", "index")]
    assert backend.watch.statistics()["mapping"]["runs"] == 2


def test_the_first_keyframes_of_a_map_only_pass_the_callbacks(backend, recorder) -> None:
    backend.insert_keyframe(0, local_mapping=False)
    assert recorder.calls == [("close loops", 0), ("index", 0)]


def test_in_step_there_is_never_anything_to_wait_for(backend) -> None:
    assert backend.is_idle()
    backend.check()
    backend.drain()
    backend.close()
    assert backend.statistics() == {}


def test_what_breaks_the_mapper_breaks_the_caller(backend, recorder) -> None:
    with pytest.raises(ZeroDivisionError, match="broken"):
        backend.insert_keyframe(-1)
    assert recorder.calls == []
