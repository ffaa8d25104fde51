"""The mapper in a thread beside the tracker."""

from __future__ import annotations

import dataclasses
import sys
import threading
import time

import numpy as np
import pytest

from prgbd.core.types import Frame, SlamResult
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.mapping.local_mapper import LocalMapper
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleResult
from tests.plugins.slam.orb_gtsam.walls import CAMERA, error, path, pose, view

POSES = path(36)
# Every frame that may become a keyframe becomes one, so that the mapper has work.
EAGER = {"keyframes": {"ratio": 2.0, "ratio_first": 2.0}}


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [view(i, wTc) for i, wTc in enumerate(POSES)]


def begin(**options) -> OrbGtsamSLAM:
    system = OrbGtsamSLAM(realtime=True, **options)
    system.reset(CAMERA, "rgbd", baseline=0.1, fps=10.0)
    return system


def run(frames: list[Frame], **options) -> SlamResult:
    with begin(**options) as system:
        for frame in frames:
            system.track(frame)
        return system.finish()


def mappers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "mapper"]


@pytest.fixture(autouse=True)
def nothing_is_left_behind():
    interval = sys.getswitchinterval()
    yield
    assert not mappers()
    assert sys.getswitchinterval() == interval


@pytest.mark.parametrize("queue", [0, 3])
def test_all_frames_are_tracked_and_all_keyframes_mapped(frames, monkeypatch, queue) -> None:
    mapped: list[int] = []
    process = LocalMapper.process

    def remember(self: LocalMapper, k: int) -> None:
        mapped.append(k)
        assert threading.current_thread().name == "mapper"
        process(self, k)

    monkeypatch.setattr(LocalMapper, "process", remember)
    result = run(frames, mapping={"queue": queue}, **EAGER)
    assert set(result.states) == {"ok"}
    truth = np.stack([POSES[i][:3, 3] for i in result.trajectory.frame_index])
    assert error(result.trajectory.positions, truth, scale=False) < 0.01
    # The first keyframe starts the map; the others are mapped in order, and none is left out.
    assert mapped == list(range(1, result.stats["keyframes_added"]))
    assert len(mapped) > 10
    assert result.stats["realtime"]["longest_queue"] <= max(queue, 1)


def test_the_tracker_waits_for_a_slow_mapper_and_says_so(frames, monkeypatch) -> None:
    process = LocalMapper.process

    def slow(self: LocalMapper, k: int) -> None:
        time.sleep(0.1)
        process(self, k)

    monkeypatch.setattr(LocalMapper, "process", slow)
    waited = run(frames[:12], **EAGER).stats["realtime"]
    assert waited["longest_queue"] == 1
    assert waited["tracker_waits"] > 3
    assert waited["tracker_waited_ms"] > 100


def test_an_exception_of_the_mapper_reaches_the_caller_as_itself(frames, monkeypatch) -> None:
    broken = ZeroDivisionError("broken")

    def fail(self: LocalMapper, k: int) -> None:
        raise broken

    monkeypatch.setattr(LocalMapper, "process", fail)
    with pytest.raises(ZeroDivisionError) as caught:
        run(frames, **EAGER)
    assert caught.value is broken
    with pytest.raises(ZeroDivisionError) as caught:
        run(frames[:2], **EAGER)
    assert caught.value is broken


def test_finish_waits_for_the_last_keyframe(frames, monkeypatch) -> None:
    process, done = LocalMapper.process, []

    def slow(self: LocalMapper, k: int) -> None:
        time.sleep(0.05)
        process(self, k)
        done.append(k)

    monkeypatch.setattr(LocalMapper, "process", slow)
    result = run(frames[:8], mapping={"queue": 8}, **EAGER)
    assert len(done) == result.stats["keyframes_added"] - 1


def test_closing_in_the_middle_stops_the_mapper(frames, monkeypatch) -> None:
    entered, process = threading.Event(), LocalMapper.process

    def announce(self: LocalMapper, k: int) -> None:
        entered.set()
        while not self.map.steps.stopped:
            time.sleep(0.001)
        process(self, k)

    monkeypatch.setattr(LocalMapper, "process", announce)
    system = begin(mapping={"queue": 50}, **EAGER)
    for frame in frames[:6]:
        system.track(frame)
    assert entered.wait(20)
    system.close()
    system.close()
    assert not mappers()


def test_a_reset_ends_the_run_before(frames) -> None:
    with begin(**EAGER) as system:
        for frame in frames[:5]:
            system.track(frame)
        system.reset(CAMERA, "rgbd", baseline=0.1, fps=10.0)
        assert len(mappers()) == 1
        assert system.track(frames[0]).is_keyframe


def test_a_keyframe_that_comes_during_bundle_adjustment_moves_with_the_adjusted_one(frames, monkeypatch) -> None:
    with OrbGtsamSLAM(**EAGER) as system:
        system.reset(CAMERA, "rgbd", baseline=0.1, fps=10.0)
        for frame in frames[:10]:
            system.track(frame)
        slam_map, solver = system._map, system._solver
        kf = slam_map.keyframes
        k, late = int(slam_map.alive()[-1]), kf.count
        moved = pose(0.3, -0.2, 0.1, 0.05)
        solve = solver.refine_locally

        def solve_while_another_comes(problem, **options) -> BundleResult:
            features = slam_map.features(k)
            system._front_end.creator.add(99, 9.9, kf.cTw[k], features, np.full(len(features), -1))
            result = solve(problem, **options)
            return dataclasses.replace(result, cTw=result.cTw @ moved)

        monkeypatch.setattr(solver, "refine_locally", solve_while_another_comes)
        system._adjuster.adjust_locally(k)
        np.testing.assert_allclose(kf.cTw[late], kf.cTw[k], atol=1e-9)
        seen = np.flatnonzero(slam_map.points_of(late) >= 0)
        xyz = slam_map.points.xyz[slam_map.points_of(late)[seen]]
        depth = (xyz @ kf.cTw[late, :3, :3].T + kf.cTw[late, :3, 3])[:, 2]
        assert len(seen) > 50
        np.testing.assert_allclose(depth, slam_map.features(late).depth[seen], rtol=1e-5)
