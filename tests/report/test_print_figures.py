import shutil

import cv2
import numpy as np
import pytest

from prgbd.core.errors import ConfigError, DataError
from prgbd.evaluation.depth import METRICS
from prgbd.io.files import read_json, write_json
from prgbd.report.__main__ import main
from prgbd.report.curves import loop_panels, range_curves
from prgbd.report.print_figures import all_figures, write_figures
from prgbd.report.reading import open_run
from tests.report.fake_run import make_run


@pytest.fixture(scope="module")
def run_with_baseline(tmp_path_factory):
    """A run of three loops whose first loop serves as a baseline, too."""
    run = make_run(tmp_path_factory.mktemp("figures") / "run", pose_errors=(4, 2, 1), depth_errors=(0.4, 0.3, 0.2))
    summary = read_json(run / "summary.json")
    shutil.copytree(run / "loops/00/slam", run / "baselines/posenet/slam")
    pose = summary["loops"][0]["pose"]
    summary["baselines"] = [{"name": "pose network", "folder": "baselines/posenet", "pose": pose, "depth": None}]
    write_json(run / "summary.json", summary)
    return run


def test_the_trajectory_figure_has_truth_baselines_and_first_and_kept_loop(run_with_baseline):
    figures = dict(all_figures(open_run(run_with_baseline)))
    assert list(figures)[:2] == ["trajectory-street-a", "depth"]
    names = [text.get_text() for text in figures["trajectory-street-a"].legends[0].get_texts()]
    assert [name.split(",")[0] for name in names] == [
        "truth", "pose network", "pRGBD-Initial", "pRGBD-Refined 2", "start",
    ]  # fmt: skip
    (ax, *_) = figures["sq_rel-by-loop"].axes
    assert len(ax.lines) == 2  # caps of 30 and 80 m
    expected = [loop["depth"]["by_cap"][0]["sq_rel"] for loop in open_run(run_with_baseline).loops]
    np.testing.assert_allclose(ax.lines[0].get_ydata(), expected)


def test_every_depth_metric_has_its_curves(run_with_baseline):
    run = open_run(run_with_baseline)
    names = {drawing.name for drawing in range_curves(run)}
    assert {f"{metric}-by-{over}" for metric in METRICS for over in ("cap", "loop")} <= names
    assert {f"{metric}-by-distance" for metric in ("abs_rel", "sq_rel", "rmse")} <= names
    assert len(loop_panels(run)) == 1 + len(METRICS)


def test_files_are_written_beside_the_report(run_with_baseline, capsys):
    assert main([str(run_with_baseline), "--figures", "png", "svg"]) == 0
    written = {path.name for path in (run_with_baseline / "figures").iterdir()}
    assert {"trajectory-street-a.png", "trajectory-street-a.svg", "depth.png", "rmse-by-distance.svg"} <= written
    assert not any(name.endswith("pdf") for name in written)
    assert "figures/depth.png" in capsys.readouterr().out
    picture = cv2.imread(str(run_with_baseline / "figures/depth.png"))
    assert picture.shape[1] == 2100  # 7 inches at 300 dots
    assert picture.std() > 20


def test_pdf_is_the_same_every_time(tmp_path):
    run = make_run(tmp_path / "run", depth_errors=None)
    first = [path.read_bytes() for path in write_figures(run, ["pdf"])]
    assert first[0][:5] == b"%PDF-"
    assert [path.read_bytes() for path in write_figures(run, ["pdf"])] == first


def test_what_cannot_be_drawn_is_said(run_with_baseline, tmp_path, capsys):
    with pytest.raises(ConfigError, match="no format 'gif'"):
        write_figures(run_with_baseline, ["gif"])
    write_json(tmp_path / "summary.json", {"loops": []})
    with pytest.raises(DataError, match="neither trajectories nor depth"):
        write_figures(tmp_path)
    assert main([str(run_with_baseline), "--figures", "gif"]) == 2
    assert "choose pdf, png, svg" in capsys.readouterr().err


def test_in_a_room_there_is_nothing_to_draw_by_range(run_with_baseline):
    run = open_run(run_with_baseline)
    assert {curve.name for curve in range_curves(run)} >= {"rmse-by-cap", "rmse-by-distance", "rmse-by-loop"}
    for loop in run.loops:
        depth = loop["depth"]
        depth["by_cap"] = [{**depth["by_cap"][0], "cap": cap} for cap in (30, 80)]
        depth["by_depth"] = [{**row, "pixels": 9 if i == 0 else 0} for i, row in enumerate(depth["by_depth"])]
    assert range_curves(run) == []
