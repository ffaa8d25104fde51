import csv
import io

import pytest
from rich.console import Console

from prgbd.io.files import read_json
from prgbd.report.paper import published_ablation, published_depth, published_pose
from prgbd.report.tables import (
    Column,
    Table,
    depth_table,
    loops_table,
    pose_table,
    print_summary,
    to_csv,
    to_html,
    to_latex,
    to_markdown,
    write_metrics_csv,
)


@pytest.fixture
def table():
    rows = [["a|b", 2.0, 0.5], ["c_d", 1.0, None], ["paper", 0.1, 0.9]]
    return Table("T", [Column("run"), Column("error (%)", "min"), Column("δ<1.25", "max")], rows, "50 % note", 2)


def test_markdown_marks_the_best_of_the_contenders(table):
    text = to_markdown(table)
    assert "| a\\|b | 2.00 | 0.500 |" in text  # the only figure of a column is not the best of anything
    assert "| c_d | **1.00** | – |" in text
    assert "| paper | 0.100 | 0.900 |" in text
    assert text.index("| --- | ---: | ---: |") < text.index("50 % note")


def test_csv_has_full_figures_and_empty_cells(table):
    rows = list(csv.reader(io.StringIO(to_csv(table))))
    assert rows[0] == ["run", "error (%)", "δ<1.25"]
    assert rows[2] == ["c_d", "1.0", ""]


def test_latex_escapes_what_latex_reads(table):
    text = to_latex(table)
    assert r"c\_d & \textbf{1.00} & -- \\" in text
    assert r"error (\%) & $\delta$$<$1.25" in text
    assert r"\begin{tabular}{lrr}" in text
    assert "50 \\% note" in text


def test_html_escapes_names():
    text = to_html(Table("<T>", [Column("a"), Column("b")], [["<script>", 1]]))
    assert "<script>" not in text
    assert "&lt;script&gt;" in text


def test_the_loops_table_has_the_figures_of_the_summary(run_folder):
    summary = read_json(run_folder / "summary.json")
    table = loops_table(summary)
    column = [c.title for c in table.columns].index("ATE RMSE (m)")
    assert [row[column] for row in table.rows] == [loop["pose"]["street-a"]["ate_rmse"] for loop in summary["loops"]]
    assert [row[1] for row in table.rows] == ["147/150", "150/150", "150/150"]
    assert "Sim3 alignment" in table.note
    assert "3 images" in table.note


def test_the_benchmark_is_explained_where_it_has_figures(run_folder):
    summary = read_json(run_folder / "summary.json")
    assert "Rel Tr" in pose_table(summary).note
    for loop in summary["loops"]:
        loop["pose"]["street-a"] |= {"kitti_translation_percent": None, "kitti_rotation_deg_per_m": None}
    assert "Rel Tr" not in pose_table(summary).note  # too short for its segments


def test_the_paper_stands_beside_its_own_sequences_only(run_folder):
    summary = read_json(run_folder / "summary.json")
    assert not any("paper" in str(row[0]) for row in pose_table(summary).rows + depth_table(summary).rows)
    for loop in summary["loops"]:
        loop["pose"] = {"09": loop["pose"]["street-a"]}
    summary |= {"data": "kitti_odometry", "sequences": ["09"]}
    rows = {row[0]: row for row in pose_table(summary).rows}
    assert rows["09, pRGBD-Refined (paper)"][2] == 11.97
    assert any(row[0] == "pRGBD-Refined (paper)" and row[1] == 0.121 for row in depth_table(summary).rows)
    assert "another set of images" in depth_table(summary).note
    for loop in summary["loops"]:
        loop["depth"]["images"] = 697
    assert "as many as here" in depth_table(summary | {"data": "kitti_raw"}).note
    assert published_pose("tum_rgbd", "rgbd_dataset_freiburg3_walking_xyz")["RGB ORB-SLAM"][0] is None
    assert published_depth({"data": "kitti_odometry", "sequences": ["00"]}) is None
    assert published_ablation("loss=no_photometric") == (0.942, 4.855)
    assert published_ablation("seed=1") is None
    assert published_ablation("depth=all") is None


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_terminal_shows_whole_figures_at_any_width(run_folder, width):
    summary = read_json(run_folder / "summary.json")
    console = Console(width=width, file=io.StringIO(), force_terminal=False)
    print_summary(summary, console)
    text = console.file.getvalue()
    assert max(len(line) for line in text.splitlines()) <= width
    for loop in summary["loops"]:
        assert f"{loop['depth']['abs_rel']:.3f}" in text
    assert "Over 2 loops" in text


def test_an_empty_summary_prints():
    console = Console(file=io.StringIO())
    print_summary({"loops": []}, console)
    assert "has not finished a loop" in console.file.getvalue()


def test_metrics_csv_holds_every_figure_in_full(run_folder, tmp_path):
    summary = read_json(run_folder / "summary.json")
    summary["loops"][1]["pose"]["street-a"]["doubts"] = ["the camera jumps", "keypoints are off"]
    write_metrics_csv(summary, tmp_path / "metrics.csv")
    with open(tmp_path / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["loop", "name", "kind", "sequence", "metric", "value"]
    found = {(r["loop"], r["kind"], r["sequence"], r["metric"]): r["value"] for r in rows}
    assert len(found) == len(rows)
    assert float(found["1", "pose", "street-a", "ate_rmse"]) == summary["loops"][1]["pose"]["street-a"]["ate_rmse"]
    assert float(found["2", "depth", "", "abs_rel"]) == summary["loops"][2]["depth"]["abs_rel"]
    assert found["0", "depth", "", "cap"] == "0.001 80"
    assert found["0", "sensing", "street-a", "baseline"] == "0.54"
    assert ("0", "depth", "", "by_cap") not in found
    assert found["1", "pose", "street-a", "doubts"] == "the camera jumps; keypoints are off"
