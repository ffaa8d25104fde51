import csv
from dataclasses import replace

import pytest

from prgbd.core.errors import DataError
from prgbd.io.files import read_json, write_json
from prgbd.report.__main__ import main
from prgbd.report.ablation import ablation_tables, join
from prgbd.report.joined import means_over_recordings, paired_differences, spread_over_seeds, with_joined
from prgbd.report.labels import find_runs, run_labels
from prgbd.report.paper import published_refinement
from prgbd.report.table import Spread, Table
from tests.report.fake_run import make_run


def override(run, *items):
    (run / ".hydra").mkdir()
    (run / ".hydra" / "overrides.yaml").write_text("".join(f"- {item}\n" for item in items))


@pytest.fixture(scope="module")
def multirun(tmp_path_factory):
    folder = tmp_path_factory.mktemp("multirun")
    losses = {"paper": 0.15, "paper_no_depth_consistency": 0.2, "paper_no_photometric": 0.25}
    for number, (loss, error) in enumerate(losses.items()):
        run = make_run(folder / str(number), depth_errors=(0.35, error))
        override(run, "+slam=orb_gtsam", f"loss={loss}", "data.frames=20")
    return folder


def test_one_row_per_run_labelled_by_what_varied(multirun):
    table = ablation_tables(multirun)[0]
    rows = table.rows
    assert [r["run"] for r in rows] == ["loss=paper", "loss=paper_no_depth_consistency", "loss=paper_no_photometric"]
    for number, row in enumerate(rows):
        loops = read_json(multirun / str(number) / "summary.json")["loops"]
        assert row["Abs Rel"] == loops[-1]["depth"]["abs_rel"]
        assert row["ATE first (m)"] == loops[0]["pose"]["street-a"]["ate_rmse"]
        assert row["loops"] == 1
    assert [r["Sq Rel (paper)"] for r in rows] == [0.931, 0.958, 0.942]
    assert table.marks("Abs Rel") == [True, False, False]
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
    assert "loss=paper_no_depth_consistency" in markdown
    assert r"loss=paper\_no\_depth\_consistency" in latex
    rows = list(csv.DictReader(table.splitlines()))
    assert len(rows) == 3
    assert float(rows[0]["RMSE"]) == read_json(multirun / "0/summary.json")["loops"][-1]["depth"]["rmse"]


def made(titles, rows, **best):
    return Table.of("Ablation", [dict(zip(titles, row, strict=True)) for row in rows], best=best)


def test_rows_that_differ_in_the_recording_alone_are_averaged():
    titles, rows = ("run", "Abs Rel", "Sq Rel"), []
    for world, errors in (("a", (0.1, 1.0)), ("b", (0.2, None))):
        rows.append((f"data.sequences=[{world}, c], loss=all", *errors))
        rows.append((f"data.sequences=[{world}, c], loss=no_photometric", 3 * errors[0], 2.0))
    means = means_over_recordings(made(titles, rows))
    assert means.titles == ["run", "runs", "Abs Rel", "Sq Rel"]
    expected = {"run": "loss=all", "runs": 2, "Abs Rel": pytest.approx(0.15), "Sq Rel": None}
    assert means.rows[0] == expected
    assert means.rows[1] == {"run": "loss=no_photometric", "runs": 2, "Abs Rel": pytest.approx(0.45), "Sq Rel": 2.0}
    assert "recordings that all rows have" in means.note
    rows.append(("data.sequences=[d], loss=all", 9.0, 9.0))  # no_photometric did not finish there
    assert means_over_recordings(made(titles, rows)).rows[0] == expected
    rows = [rows[0], rows[2], rows[4]]
    assert means_over_recordings(made(titles, rows)).rows[0]["runs"] == 3
    rows.append(("data.sequences=[e], loss=all", None, None))
    assert means_over_recordings(made(titles, rows)).rows[0]["runs"] == 3
    assert means_over_recordings(made(titles, rows[:1])) is None


def test_rows_without_a_common_recording_say_so():
    runs = (("a", "all"), ("b", "all"), ("c", "no_photometric"))
    rows = [(f"data.sequences=[{world}], loss={loss}", 0.1) for world, loss in runs]
    table = made(("run", "Abs Rel"), rows, **{"Abs Rel": "min"})
    means = means_over_recordings(table)
    assert means.frame["runs"].tolist() == [2, 1]
    assert "not the same recordings" in means.note
    assert paired_differences(table) is None


def test_rows_are_compared_on_the_recordings_that_they_share():
    """The worlds differ by more than the rows do, yet the row without the term is worse on each of them."""
    titles, rows = ("run", "Abs Rel first", "Abs Rel", "a1"), []
    best = {"Abs Rel first": "min", "Abs Rel": "min", "a1": "max"}
    worlds = {"a": (0.10, 0.12, 0.9, 0.8), "b": (0.20, 0.23, 0.7, 0.8), "c": (0.40, 0.44, 0.5, 0.6)}
    for world, (error, without, a1, a1_without) in worlds.items():
        rows.append((f"loss=no_photometric, data.sequences=[{world}]", 1, without, a1_without))
        rows.append((f"loss=all, data.sequences=[{world}]", 1, error, a1))
    rows.append(("loss=no_photometric, data.sequences=[d]", 1, 9.0, 9.0))  # loss=all did not finish
    rows.append(("loss=sparse, data.sequences=[a]", 1, 9.0, 9.0))
    paired = paired_differences(made(titles, rows, **best))
    assert "differences from loss=all" in paired.title
    # The errors are 0.02, 0.03 and 0.04 apart; of a1 more is better.
    assert paired.rows == [
        {
            "run": "loss=no_photometric",
            "Abs Rel": "+0.0300 ± 0.00577, worse on 3 of 3",
            "a1": "+0.0333 ± 0.0667, worse on 1 of 3",
        }
    ]
    assert paired_differences(made(titles, rows[:2], **best)) is None


def test_runs_that_differ_in_the_seed_alone_are_joined():
    titles = ("run", "loops", "tracked", "ATE last (m)", "Abs Rel")
    rows = [(f"loss={loss}, seed={s}", 2, "9/9", 1.0, e) for loss, e in (("all", 0.1), ("none", 0.5)) for s in (0, 1)]
    rows[1] = ("loss=all, seed=1", 2, "9/9", 3.0, None)
    table = made(titles, [*rows, ("Tiwari et al. (paper)", None, None, 9.0, 0.01)], **{"Abs Rel": "min"})
    table = replace(table, contenders=4)
    joined = spread_over_seeds(table)
    assert joined.titles == ["run", "runs", "loops", "tracked", "ATE last (m)", "Abs Rel"]
    first, second, paper = joined.rows
    assert first == {
        "run": "loss=all", "runs": 2, "loops": 2, "tracked": "9/9", "ATE last (m)": 2.0, "Abs Rel": None,
    }  # fmt: skip
    assert isinstance(first["ATE last (m)"], Spread)
    assert first["ATE last (m)"].deviation == pytest.approx(2**0.5)
    assert second["Abs Rel"] == 0.5
    assert paper["run"] == "Tiwari et al. (paper)"
    assert joined.contenders == 2
    each, same = with_joined(table)
    assert same.rows == joined.rows
    assert not any(any(each.marks(title)) for title in each.titles)  # a seed is not better than another
    assert spread_over_seeds(made(titles, rows[::2])) is None


def test_seeds_are_joined_before_recordings_are_compared():
    rows = [
        (f"loss={loss}, data.sequences=[{world}], seed={seed}", 1, error + 0.1 * seed)
        for loss, error in (("all", 0.1), ("none", 0.2))
        for world in "ab"
        for seed in (0, 1)
    ]
    _, seeds, means, differences = with_joined(made(("run", "loops", "Abs Rel"), rows, **{"Abs Rel": "min"}))
    assert len(seeds.rows) == 4
    assert means.frame["Abs Rel"].tolist() == pytest.approx([0.15, 0.25])
    assert differences.rows[0]["Abs Rel"].endswith("worse on 2 of 2")


def test_recordings_do_not_compete_for_the_best_figure(tmp_path):
    errors = {"a": (0.1, 0.2), "b": (0.3, 0.4)}
    for world, pair in errors.items():
        for loss, error in zip(("all", "no_photometric"), pair, strict=True):
            run = make_run(tmp_path / f"{world}{loss}", depth_errors=(0.5, error))
            override(run, f"data.sequences=[{world}]", f"loss={loss}")
    runs, means, differences = ablation_tables(tmp_path)
    assert not any(any(runs.marks(title)) for title in runs.titles)
    assert means.marks("Abs Rel") == [True, False]
    difference = differences.rows[0]["Abs Rel"]
    assert difference.startswith("+")
    assert difference.endswith("worse on 2 of 2")


def test_the_paper_s_loops_stand_below_runs_on_its_test_recordings(tmp_path):
    for seed in range(2):
        data = {"data": "kitti_odometry", "test_sequences": ["09", "10"]}
        run = make_run(tmp_path / str(seed), sequences=("00", "09", "10"), depth_errors=None, **data)
        override(run, f"seed={seed}")
    table, joined = ablation_tables(tmp_path)
    rows = table.rows
    pose = read_json(tmp_path / "0/summary.json")["loops"][1]["pose"]
    assert rows[0]["ATE last (m)"] == pytest.approx((pose["09"]["ate_rmse"] + pose["10"]["ate_rmse"]) / 2)
    assert rows[0]["tracked"] == "300/300"
    assert "mean over test sequences" in table.note
    paper = rows[2]
    assert paper["run"] == "Tiwari et al. (paper)"
    assert paper["ATE first (m)"] == pytest.approx((12.21 + 8.30) / 2)
    assert paper["ATE last (m)"] == pytest.approx((11.97 + 6.35) / 2)
    assert joined.rows[1]["ATE last (m)"] == paper["ATE last (m)"]
    assert joined.rows[0]["runs"] == 2
    assert "Abs Rel" not in paper  # the runs have no depth to compare with
    assert table.contenders == 2  # the paper's figures do not compete


def test_runs_on_other_data_get_no_row_of_the_paper(multirun):
    assert not any("et al." in row["run"] for row in ablation_tables(multirun)[0].rows)
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
    assert table.frame["run"].tolist() == ["seed=0", "seed=1"]
    assert table.frame.iloc[1, 1:].isna().all()
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
