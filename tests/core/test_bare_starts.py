"""Maps that never grew are no tracking, whatever system made them."""

from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.bare_starts import bare_starts, without_bare_starts
from prgbd.core.types import Keyframes
from tests.loop.fakes import Sideways, Wall


@pytest.fixture
def result():
    wall, system = Wall(frames=8), Sideways(every=2)
    system.reset(wall.camera, "rgbd", baseline=0.1, fps=10.0)
    for frame in wall:
        system.track(frame)
    return system.finish()


def with_maps(result, frames, maps):
    rows = np.asarray(frames)
    keyframes = Keyframes(rows, rows * 0.1, result.trajectory.wTc[rows], np.asarray(maps, np.int32))
    seen = result.observations
    kept = seen.keyframe < len(rows)
    observations = type(seen)(seen.keyframe[kept], seen.point[kept], seen.uv[kept], seen.depth[kept])
    return replace(result, keyframes=keyframes, observations=observations)


def test_one_map_with_keyframes_is_left_as_it_is(result):
    assert without_bare_starts(result) is result


@pytest.mark.parametrize(
    ("frames", "maps", "bare"),
    [
        ([0, 1, 2, 3, 4, 5, 6, 7], range(8), [0, 1, 2, 3, 4, 5, 6, 7]),  # a new map per frame
        ([0], [0], []),  # a camera that stands still is found again and again in its one keyframe
        ([0, 3, 4], [0, 1, 2], [3]),  # the map of frame 3 was left at once
        ([0, 2, 7], [0, 0, 1], [7]),  # a start at the very end
        ([], [], []),  # a system without keyframes cannot be judged
    ],
)
def test_frames_that_started_a_map_without_followers_are_lost(result, frames, maps, bare):
    given = with_maps(result, np.asarray(frames, np.int64), list(maps))
    assert given.keyframes.frame_index[bare_starts(given)].tolist() == bare
    kept = without_bare_starts(given)
    assert [i for i, state in enumerate(kept.states) if state == "lost"] == bare
    assert sorted({*kept.trajectory.frame_index.tolist(), *bare}) == list(range(8))
    assert kept.tracked_frames == len(kept.online) == 8 - len(bare)
    assert not set(kept.keyframes.frame_index.tolist()) & set(bare)
    assert len(kept.keyframes) == len(frames) - len(bare)
    if len(kept.observations):
        assert kept.observations.keyframe.max() < len(kept.keyframes)
        assert kept.observations.point.max() < len(kept.points)
    assert without_bare_starts(kept) is kept
