import csv
import io
import shutil
import subprocess

import pytest
from rich.console import Console

from prgbd.core.errors import ConfigError
from prgbd.io.files import read_json
from prgbd.report.paper import published_ablation, published_depth, published_pose
from prgbd.report.rendering import to_csv, to_latex, to_markdown
from prgbd.report.table import Spread, Table, choose_columns, column_key
from prgbd.report.tables import depth_table, loops_table, pose_table, print_summary, run_tables, write_metrics_csv
from prgbd.report.templates import render


@pytest.fixture
def table():
    titles = ("run", "error (%)", "δ<1.25")
    rows = [("a|b", 2.0, 0.5), ("c_d", 1.0, None), ("paper", 0.1, 0.9)]
    best = {"error (%)": "min", "δ<1.25": "max"}
    return Table.of(
        "T", [dict(zip(titles, row, strict=True)) for row in rows], best=best, note="50 % note", contenders=2
    )


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
    evil = "<script>"
    page = {"runs": [(evil, evil, evil)], "views": [(evil, None)][:0]}
    table = Table.of(evil, [{"a": evil, evil: 1}, {"a": "b", evil: 2}], best={evil: "min"}, note=evil)
    text = render("comparison.html", tables=[table], settings=table, **page)
    assert evil not in text.replace("<script>/* Trajectories", "")  # the page's own
    assert '<th scope="row">&lt;script&gt;</th>' in text
    assert "<td><b>1</b></td>" in text


def test_what_prints_the_same_is_marked_the_same():
    """The best is the best unrounded figure, with all that a reader cannot tell from it; equal columns have none."""
    rows = [{"run": r, "a": a, "b": b} for r, a, b in (("x", 0.12301, 0.5), ("y", 0.12299, 0.5002), ("z", 0.2, 0.5001))]
    table = Table.of("T", rows, best={"a": "min", "b": "min"})
    assert table.marks("a") == [True, True, False]
    assert table.marks("b") == [False] * 3
    assert table.marks("run") == [False] * 3


def wide_table(columns, rows=3):
    titles = [f"column {i}" for i in range(columns)]
    return Table.of("T", [{"run": f"run {r}"} | dict.fromkeys(titles, r + 0.5) for r in range(rows)], note="N")


def test_a_latex_table_fits_a_page():
    one = to_latex(wide_table(30))  # turned on its side
    assert one.count(r"\begin{tabular}") == 1
    assert r"\begin{tabular}{lrrr}" in one
    several = to_latex(wide_table(30, rows=30))
    assert several.count(r"\begin{table}") > 1
    assert all(len(row) <= 110 for row in several.splitlines() if "&" in row)
    assert several.count("column 7 & ") == several.count(r"\begin{tabular}")  # each part has the names
    assert "(1 of " in several
    assert several.count(" N}") == 1  # the note stands once
    long = to_latex(wide_table(2, rows=100))
    assert long.count(r"\begin{table}") == 3
    assert r"\resizebox{\linewidth}" not in several + long
    names = Table.of("T", [{"run": "x" * 90, "a": 1.0, "b": 2.0}, {"run": "y", "a": 1.0, "b": 2.0}])
    assert r"\resizebox{\linewidth}" in to_latex(names)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX is installed")
@pytest.mark.parametrize(("columns", "rows"), [(4, 3), (30, 3), (30, 30), (3, 100)])
def test_latex_finds_nothing_too_large(columns, rows, tmp_path):
    text = to_latex(wide_table(columns, rows))
    text = "\n".join(
        [r"\documentclass{article}\usepackage{booktabs,graphicx}\begin{document}", text, r"\end{document}"]
    )
    (tmp_path / "t.tex").write_text(text)
    command = ["pdflatex", "-interaction=nonstopmode", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull" not in done.stdout
    assert "too large" not in done.stdout


def test_columns_are_chosen_by_name(run_folder):
    titles = ("ATE last (m)", "ATE, test (m)", "δ<1.25²", "Abs Rel first", "Sq Rel (paper)", "Rel Rot (°/m)")
    assert [column_key(title) for title in titles] == [
        "ate_last",
        "ate_test",
        "a2",
        "abs_rel_first",
        "sq_rel",
        "rel_rot",
    ]
    tables = run_tables(read_json(run_folder / "summary.json"))
    loops, depth = choose_columns(tables, ["rmse", "abs_rel"])
    assert loops.titles == ["loop", "RMSE (m)", "Abs Rel"]
    assert depth.titles == ["loop", "RMSE", "Abs Rel"]
    assert [table.title for table in choose_columns(tables, ["a3"])] == ["Depth"]
    assert choose_columns(tables, []) == tables
    with pytest.raises(ConfigError, match="no column 'speed'; choose from tracked, ate_rmse"):
        choose_columns(tables, ["abs_rel", "speed"])


def test_a_spread_prints_with_its_deviation_and_counts_as_its_mean():
    rows = [{"run": "a", "x": Spread(1.0, 0.25)}, {"run": "b", "x": Spread(2.0, 0.5)}, {"run": "c", "x": 3.0}]
    table = Table.of("T", rows, best={"x": "min"})
    assert table.cells()[0] == [("a", False), ("1.00 ± 0.250", True)]
    assert r"1.00 $\pm$ 0.250" in to_latex(table)
    assert to_csv(table).splitlines() == ["run,x,x std", "a,1.0,0.25", "b,2.0,0.5", "c,3.0,"]


def test_the_loops_table_has_the_figures_of_the_summary(run_folder):
    summary = read_json(run_folder / "summary.json")
    table = loops_table(summary)
    assert table.frame["ATE RMSE (m)"].tolist() == [loop["pose"]["street-a"]["ate_rmse"] for loop in summary["loops"]]
    assert table.frame["tracked"].tolist() == ["147/150", "150/150", "150/150"]
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
    assert not any("paper" in name for make in (pose_table, depth_table) for name in make(summary).frame.iloc[:, 0])
    for loop in summary["loops"]:
        loop["pose"] = {"09": loop["pose"]["street-a"]}
    summary |= {"data": "kitti_odometry", "sequences": ["09"]}
    rows = {row["sequence, loop"]: row for row in pose_table(summary).rows}
    assert rows["09, pRGBD-Refined (paper)"]["ATE RMSE (m)"] == 11.97
    rows = {row["loop"]: row for row in depth_table(summary).rows}
    assert rows["pRGBD-Refined (paper)"]["Abs Rel"] == 0.121
    assert "another set of images" in depth_table(summary).note
    for loop in summary["loops"]:
        loop["depth"]["images"] = 697
    assert "as many as here" in depth_table(summary | {"data": "kitti_raw"}).note
    assert published_pose("tum_rgbd", "rgbd_dataset_freiburg3_walking_xyz")["RGB ORB-SLAM"][0] is None
    assert published_depth({"data": "kitti_odometry", "sequences": ["00"]}) is None
    assert published_ablation("loss=paper_no_photometric") == (0.942, 4.855)
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
