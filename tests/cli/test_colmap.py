"""``slam=colmap`` from the command line, with the sensor's depth to fix the scale."""

import json
from pathlib import Path

import pytest

pytest.importorskip("pycolmap", reason="slam=colmap comes with the extra 'colmap'")


def test_a_recording_is_reconstructed_and_written(run):
    world = ("data=synthetic", "data.sequences=[indoor-0]", "data.frames=20", "data.width=320", "data.height=240")
    options = ("slam.every=2", "slam.mode=mono", "slam.intrinsics=refine", "slam.threads=1", "task=slam")
    summary = run(*options, fakes=("slam=colmap", *world))
    figures = summary["loops"][0]["pose"]["indoor-0"]
    assert figures["tracked_frames"] >= 18
    assert figures["ate_rmse"] < 0.02
    stored = json.loads(next(Path("run").rglob("slam.json")).read_text())
    assert stored["stats"]["located_frames"] >= 8
    assert stored["stats"]["seconds"] > 0
    assert stored["stats"]["model_sizes"][0] == figures["keyframes"]
