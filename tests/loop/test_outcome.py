"""What failed, and what that means for the exit code."""

from dataclasses import replace

import pytest

from prgbd.core.errors import DataError, DiskError, NothingTrackedError, PartlyFailedError
from prgbd.core.types import Trajectory
from prgbd.loop.monitor import SilentMonitor
from prgbd.loop.outcome import Failures, failure, verdict, why_not_tracked
from tests.loop.fakes import Sideways, Wall


def test_an_error_of_one_recording_is_kept_for_the_end():
    failures = Failures(2, SilentMonitor())
    with failures.of("a"):
        raise DataError("a is truncated.")
    assert failures.reasons == {"a": "a is truncated."}
    with pytest.raises(DataError, match="b is"), failures.of("b"):
        raise DataError("b is truncated.")


def test_a_full_disk_ends_the_run():
    failures = Failures(2, SilentMonitor())
    with pytest.raises(DiskError), failures.of("a"):
        raise DiskError("full.")


def test_the_reasons_for_tracking_nothing():
    wall, system = Wall(), Sideways()
    system.reset(wall.camera, "rgbd")
    for frame in wall:
        system.track(frame)
    result = system.finish()
    assert why_not_tracked(result, wall) is None
    lost = replace(result, trajectory=Trajectory.empty())
    assert "images be too small (96x64), or the calibration" in why_not_tracked(lost, wall)
    assert why_not_tracked(lost, wall, lambda sequence: ("it is dark",)) == "it is dark"
    assert "its unit" in why_not_tracked(replace(lost, stats={"bare_starts": 12}), wall)


@pytest.mark.parametrize(
    ("pose", "errors", "expected", "words"),
    [
        ({"a": None, "b": None}, {}, None, ""),
        ({"a": "it is dark", "b": "it is dark"}, {}, NothingTrackedError, "Nothing was tracked in a, b: it is dark."),
        ({"a": None, "b": "it is dark"}, {}, PartlyFailedError, "1 of 2 recordings failed: b: nothing was tracked"),
        ({"a": None}, {"b": "b.png is truncated."}, PartlyFailedError, "1 of 2 recordings failed: b: b.png is"),
    ],
)
def test_the_verdict_on_a_run(pose, errors, expected, words):
    loops = [{"loop": 0, "pose": {name: {"failed": reason} for name, reason in pose.items()}}]
    summary = verdict(loops, errors, [*pose, *errors])
    error = failure(summary)
    assert type(error) is (expected or type(None))
    assert words in (summary["failed"] or "")
    assert set(summary["failed_sequences"]) == {*errors, *(name for name, reason in pose.items() if reason)}


def test_the_loop_that_is_kept_counts():
    loops = [{"loop": 0, "pose": {"a": {"failed": None}}}, {"loop": 1, "pose": {"a": {"failed": "dark"}}}]
    assert verdict(loops, {}, ["a"], 0)["failed"] is None
    assert verdict(loops, {}, ["a"])["failed"] is not None
