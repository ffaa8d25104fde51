import csv

import pytest

from prgbd.core.errors import DataError
from prgbd.io.files import read_json, write_json
from prgbd.report.__main__ import main
from prgbd.report.ablation import ablation_tables, find_runs, join, run_labels
from prgbd.report.paired import means_over_recordings, paired_differences
from prgbd.report.paper import published_refinement
from prgbd.report.rendering import Column, Table
from tests.report.fake_run import make_run


def override(run, *items):
    (run / ".hydra").mkdir()
    (run / ".hydra" / "overrides.yaml").write_text("".join(f"- {item}\n" for item in items))


@pytest.fixture(scope="module")
def multirun(tmp_path_factory):
    folder = tmp_path_factory.mktemp("multirun")
    losses = {"all": 0.15, "no_depth_consistency": 0.2, "no_photometric": 0.25}
    for number, (loss, error) in enumerate(losses.items()):
        run = make_run(folder / str(number), depth_errors=(0.35, error))
        override(run, "+slam=orb_gtsam", f"loss={loss}", "data.frames=20")
    return folder


def test_one_row_per_run_labelled_by_what_varied(multirun):
    table = ablation_tables(multirun)[0]
    titles = [c.title for c in table.columns]
    rows = [dict(zip(titles, row, strict=True)) for row in table.rows]
    assert [r["run"] for r in rows] == ["loss=all", "loss=no_depth_consistency", "loss=no_photometric"]
    for number, row in enumerate(rows):
        loops = read_json(multirun / str(number) / "summary.json")["loops"]
        assert row["Abs Rel"] == loops[-1]["depth"]["abs_rel"]
        assert row["ATE first (m)"] == loops[0]["pose"]["street-a"]["ate_rmse"]
        assert row["loops"] == 1
    assert [r["Sq Rel (paper)"] for r in rows] == [0.931, 0.958, 0.942]
    assert table.best(titles.index("Abs Rel")) == rows[0]["Abs Rel"]
    assert "KITTI Eigen" in table.note
    assert "alignment sim3" in table.note


def test_the_files_hold_the_same_table(multirun, capsys):
    assert main([str(multirun)]) == 0
    printed = capsys.readouterr().out
    assert "no_photometric" in printed
    assert max(map(len, printed.splitlines())) > 80  # a pipe or a file is as wide as the table
    paths = join(multirun)
    assert [p.name for p in paths] == ["ablation.md", "ablation.csv", "ablation.tex"]
    markdown, table, latex = (p.read_text() for p in paths)
    assert "loss=no_depth_consistency" in markdown
    assert r"loss=no\_depth\_consistency" in latex
    rows = list(csv.DictReader(table.splitlines()))
    assert len(rows) == 3
    assert float(rows[0]["RMSE"]) == read_json(multirun / "0/summary.json")["loops"][-1]["depth"]["rmse"]


def test_rows_that_differ_in_the_recording_alone_are_averaged():
    table = Table("Ablation", [Column("run"), Column("Abs Rel"), Column("Sq Rel")])
    for world, errors in (("a", (0.1, 1.0)), ("b", (0.2, None))):
        table.rows.append([f"data.sequences=[{world}, c], loss=all", *errors])
        table.rows.append([f"data.sequences=[{world}, c], loss=no_photometric", 3 * errors[0], 2.0])
    means = means_over_recordings(table)
    assert [c.title for c in means.columns] == ["run", "runs", "Abs Rel", "Sq Rel"]
    assert means.rows[0] == ["loss=all", 2, pytest.approx(0.15), None]
    assert means.rows[1] == ["loss=no_photometric", 2, pytest.approx(0.45), 2.0]
    assert "recordings that all rows have" in means.note
    table.rows.append(["data.sequences=[d], loss=all", 9.0, 9.0])  # no_photometric did not finish there
    assert means_over_recordings(table).rows[0] == means.rows[0]
    table.rows = [table.rows[0], table.rows[2], table.rows[4]]
    assert means_over_recordings(table).rows[0][:2] == ["loss=all", 3]
    table.rows.append(["data.sequences=[e], loss=all", None, None])
    assert means_over_recordings(table).rows[0][1] == 3
    table.rows = table.rows[:1]
    assert means_over_recordings(table) is None


def test_rows_without_a_common_recording_say_so():
    table = Table("Ablation", [Column("run"), Column("Abs Rel", "min")])
    for world, loss in (("a", "all"), ("b", "all"), ("c", "no_photometric")):
        table.rows.append([f"data.sequences=[{world}], loss={loss}", 0.1])
    means = means_over_recordings(table)
    assert [row[1] for row in means.rows] == [2, 1]
    assert "not the same recordings" in means.note
    assert paired_differences(table) is None


def test_rows_are_compared_on_the_recordings_that_they_share():
    """The worlds differ by more than the rows do, yet the row without the term is worse on each of them."""
    titles = [Column("run"), Column("Abs Rel first", "min"), Column("Abs Rel", "min"), Column("a1", "max")]
    table = Table("Ablation", titles)
    worlds = {"a": (0.10, 0.12, 0.9, 0.8), "b": (0.20, 0.23, 0.7, 0.8), "c": (0.40, 0.44, 0.5, 0.6)}
    for world, (error, without, a1, a1_without) in worlds.items():
        table.rows.append([f"loss=no_photometric, data.sequences=[{world}]", 1, without, a1_without])
        table.rows.append([f"loss=all, data.sequences=[{world}]", 1, error, a1])
    table.rows.append(["loss=no_photometric, data.sequences=[d]", 1, 9.0, 9.0])  # loss=all did not finish
    table.rows.append(["loss=sparse, data.sequences=[a]", 1, 9.0, 9.0])
    paired = paired_differences(table)
    assert "differences from loss=all" in paired.title
    assert [c.title for c in paired.columns] == ["run", "Abs Rel", "a1"]
    assert [row[0] for row in paired.rows] == ["loss=no_photometric"]
    _, error, a1 = paired.rows[0]
    assert error == "+0.0300 ± 0.00577, worse on 3 of 3"  # 0.02, 0.03, 0.04
    assert a1 == "+0.0333 ± 0.0667, worse on 1 of 3"  # higher is better
    table.rows = table.rows[:2]
    assert paired_differences(table) is None


def test_recordings_do_not_compete_for_the_best_figure(tmp_path):
    errors = {"a": (0.1, 0.2), "b": (0.3, 0.4)}
    for world, pair in errors.items():
        for loss, error in zip(("all", "no_photometric"), pair, strict=True):
            run = make_run(tmp_path / f"{world}{loss}", depth_errors=(0.5, error))
            override(run, f"data.sequences=[{world}]", f"loss={loss}")
    runs, means, differences = ablation_tables(tmp_path)
    assert all(runs.best(i) is None for i in range(len(runs.columns)))
    column = [c.title for c in means.columns].index("Abs Rel")
    assert means.best(column) == means.rows[0][column]
    difference = differences.rows[0][[c.title for c in differences.columns].index("Abs Rel")]
    assert difference.startswith("+")
    assert difference.endswith("worse on 2 of 2")


def test_the_paper_s_loops_stand_below_runs_on_its_test_recordings(tmp_path):
    for seed in range(2):
        data = {"data": "kitti_odometry", "test_sequences": ["09", "10"]}
        run = make_run(tmp_path / str(seed), sequences=("00", "09", "10"), depth_errors=None, **data)
        override(run, f"seed={seed}")
    table = ablation_tables(tmp_path)[0]
    rows = [dict(zip([c.title for c in table.columns], row, strict=True)) for row in table.rows]
    pose = read_json(tmp_path / "0/summary.json")["loops"][1]["pose"]
    assert rows[0]["ATE last (m)"] == pytest.approx((pose["09"]["ate_rmse"] + pose["10"]["ate_rmse"]) / 2)
    assert rows[0]["tracked"] == "300/300"
    assert "mean over test sequences" in table.note
    paper = rows[2]
    assert paper["run"] == "Tiwari et al. (paper)"
    assert paper["ATE first (m)"] == pytest.approx((12.21 + 8.30) / 2)
    assert paper["ATE last (m)"] == pytest.approx((11.97 + 6.35) / 2)
    assert "Abs Rel" not in paper  # the runs have no depth to compare with
    assert table.contenders == 2  # the paper's figures do not compete


def test_runs_on_other_data_get_no_row_of_the_paper(multirun):
    assert not any("et al." in str(row[0]) for row in ablation_tables(multirun)[0].rows)
    assert published_refinement("kitti_odometry", ["00", "09"]).keys() >= {"abs_rel"}
    assert "ate_last" not in published_refinement("kitti_odometry", ["00", "09"])
    assert published_refinement("tum_rgbd", ["rgbd_dataset_freiburg3_walking_xyz"])["ate_last"] == 0.09
    assert published_refinement("synthetic", ["street-0"]) == {}


def test_an_unfinished_run_is_a_row_without_figures(tmp_path):
    run = make_run(tmp_path / "0")
    override(run, "seed=0")
    other = tmp_path / "1"
    other.mkdir()
    (other / "config.yaml").write_text("seed: 1\n")
    override(other, "seed=1")
    table = ablation_tables(tmp_path)[0]
    assert [row[0] for row in table.rows] == ["seed=0", "seed=1"]
    assert all(cell is None for cell in table.rows[1][1:])
    assert "Did not finish: seed=1." in table.note


def test_labels_fall_back_to_configuration_and_then_to_folders(tmp_path):
    for name, weight in (("a", 1), ("b", 0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.yaml").write_text(f"loss:\n  transfer: {weight}\nout: runs/{name}\nx: ${{y}}\n")
    paths = [tmp_path / "a", tmp_path / "b"]
    assert run_labels(paths) == ["loss.transfer=1", "loss.transfer=0"]
    for name, loss in (("a", "all"), ("b", "no_photometric")):
        with open(tmp_path / name / "config.yaml", "a") as file:
            file.write(f"run:\n  overrides: [x={name}]\n  choices:\n    loss: {loss}\n    slam: s\n")
    assert run_labels(paths) == ["loss=all", "loss=no_photometric"]
    (tmp_path / "b" / "config.yaml").write_text("{broken: [")
    assert run_labels(paths) == ["a", "b"]


def test_runs_are_found_below_and_in_natural_order(tmp_path):
    for name in ("x/10", "x/9", "y/z/2", ".hidden/1"):
        write_json(tmp_path / name / "summary.json", {"loops": []})
    write_json(tmp_path / "x/9/loops/summary.json", {})
    assert [str(p.relative_to(tmp_path)) for p in find_runs(tmp_path)] == ["x/9", "x/10", "y/z/2"]


def test_a_folder_without_runs_is_a_data_error(tmp_path):
    with pytest.raises(DataError, match="no run below"):
        join(tmp_path)
    with pytest.raises(DataError, match="There is no folder"):
        join(tmp_path / "nowhere")
    (tmp_path / "config.yaml").write_text("seed: 0\n")
    with pytest.raises(DataError, match="no figures yet; go on with it: python -m prgbd resume="):
        join(tmp_path)
