import contextlib

import numba
import pytest

from prgbd.core.errors import DataError
from prgbd.loop.monitor import SilentMonitor
from prgbd.loop.slam_runs import KINECT_BASELINE, describe_pose, pose_figures, run_slam, sensor_input
from tests.loop.fakes import Sideways, Wall


def test_figures_of_a_run():
    sequence = Wall(frames=9)
    result = run_slam(Sideways, sequence, sensor_input(sequence, "mono", None), seed=2)
    figures = pose_figures(result, sequence)
    assert (figures["frames"], figures["tracked_frames"], figures["lost_frames"]) == (9, 9, 0)
    assert figures["keyframes"] == 5
    assert figures["fps"] == pytest.approx(9 / figures["seconds"])
    assert result.stats["seed"] == 2
    assert 0 < figures["ate_rmse"] < 0.05


@pytest.mark.parametrize(("fixed", "own", "used"), [(0.3, 0.5, 0.3), (None, 0.5, 0.5), (None, None, KINECT_BASELINE)])
def test_baseline_of_a_sensor(fixed, own, used):
    sequence = Wall(sensor=True)
    sequence.baseline = own
    assert sensor_input(sequence, "rgbd", fixed).baseline == used


def test_compiling_is_no_tracking():
    """A system that compiles at its first frame: neither rate counts it."""

    class Compiles(Sideways):
        def track(self, frame):
            if frame.index == 0:
                numba.njit(lambda x: x + 1)(1)
            return super().track(frame)

    left_out = []

    class Watches(SilentMonitor):
        @contextlib.contextmanager
        def stage(self, title, total):
            with super().stage(title, total) as progress:
                progress.leave_out = left_out.append
                yield progress

    sequence = Wall()
    stats = run_slam(Compiles, sequence, sensor_input(sequence, "mono", None), monitor=Watches()).stats
    assert left_out == [stats["compile_seconds"]]
    assert left_out[0] > 0.001
    again = run_slam(Sideways, sequence, sensor_input(sequence, "mono", None), monitor=Watches()).stats
    assert again["compile_seconds"] == 0
    assert len(left_out) == 1


def test_mono_sees_no_depth():
    sequence = Wall(sensor=True)
    assert all(frame.depth is None for frame in sensor_input(sequence, "mono", None).frames)


def test_rgbd_without_a_sensor_is_refused():
    with pytest.raises(DataError, match=r"'wall'.*slam\.mode=mono"):
        sensor_input(Wall(), "rgbd", None)


def test_depth_that_is_unknown_everywhere_is_refused(monkeypatch):
    sequence = Wall(sensor=True)
    frame = Wall.frame

    def blank(self, i):
        return frame(self, i).with_depth(0 * frame(self, i).depth)

    monkeypatch.setattr(Wall, "frame", lambda self, i: blank(self, i) if i < 3 else frame(self, i))
    assert sensor_input(sequence, "rgbd", None).mode == "rgbd"
    monkeypatch.setattr(Wall, "frame", blank)
    with pytest.raises(DataError, match="unknown at every pixel of every frame"):
        sensor_input(sequence, "rgbd", None)


def test_the_system_is_closed_even_when_it_fails():
    closed = []

    class Fails(Sideways):
        def track(self, frame):
            raise ZeroDivisionError

        def close(self):
            closed.append(True)

    sequence = Wall()
    with pytest.raises(ZeroDivisionError):
        run_slam(Fails, sequence, sensor_input(sequence, "mono", None))
    assert closed == [True]


def test_the_line_about_a_run_tells_the_depths_error():
    figures = {"frames": 9, "tracked_frames": 9, "keyframes": 3, "points": 5, "depth_sigma": None}
    assert "errs" not in describe_pose("00", figures)
    line = describe_pose("00", {**figures, "depth_sigma": 0.14, "depth_shared": 0.6})
    assert "depth errs by 14%, 60% of the variance shared by a frame" in line
