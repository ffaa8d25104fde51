"""The experiments of the paper's tables, run as they are on small recordings in the layouts of their data sets."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch

import prgbd
from prgbd.report.table import Table
from prgbd.report.tables import depth_table, pose_table
from tests.cli import layouts

QUICK = ("training.batch_size=4", "export=[tum]", "slam.features.count=300")
SMALL = ("depth.height=64", "depth.width=96", *QUICK)
TINY = ("depth=test/tiny", *QUICK)
"""Networks and maps that are quick; the experiment files decide everything else."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def street():
    return layouts.render("street-0", 192, 96, 80.0)


@pytest.fixture(scope="module")
def kitti_raw(tmp_path_factory, street):
    root = tmp_path_factory.mktemp("kitti_raw")
    layouts.write_kitti_raw(root / "data", street, ["0001", "0002"])
    layouts.write_split(root / "train_files.txt", ["0001"], range(layouts.FRAMES))
    layouts.write_split(root / "test_files.txt", ["0002"], [1, 5])
    return root


def summary_of(folder: str) -> dict:
    return json.loads((Path(folder) / "summary.json").read_text())


def test_layouts_are_read_back_as_they_were_rendered(tmp_path, street, kitti_raw):
    layouts.write_kitti_odometry(tmp_path / "odometry", street, ["09"])
    odometry = prgbd.make_data("kitti_odometry", root=tmp_path / "odometry")
    raw = prgbd.make_data("kitti_raw", root=kitti_raw / "data", sequence="2011_09_26_drive_0001")
    expected = np.linalg.inv(street.poses[0]) @ street.poses
    for sequence in (odometry, raw):
        assert sequence.camera == street.camera
        found = np.linalg.inv(sequence.poses[0]) @ sequence.poses
        np.testing.assert_allclose(found[:, :3, 3], expected[:, :3, 3], atol=0.02)
    measured = raw.depth(2)
    known = measured > 0
    np.testing.assert_allclose(measured[known], street.depths[2][known], rtol=1e-3)
    assert known.sum() > 500


def first_column(table: Table) -> list[str]:
    return [str(name) for name in table.frame.iloc[:, 0]]


@pytest.mark.usefixtures("real_report")
def test_kitti_odometry_with_all_rows_of_the_pose_table(cli, tmp_path, street):
    root = layouts.write_kitti_odometry(tmp_path / "kitti", street, ["00", "09"])
    network = prgbd.make_depth("monodepth2", height=64, width=96)
    with torch.no_grad():  # a network that believes in some motion, as an untrained one does not
        network.pose_network().decoder.net[3].bias += torch.linspace(0.5, 1.5, 12)
    network.save_weights(tmp_path / "weights")
    answer = cli(
        *(
            "experiment=paper/kitti_odometry",
            f"data.root={root}",
            f"depth.weights={tmp_path / 'weights'}",
            "out=run",
            *SMALL,
        ),
        *("data.sequences=[00]", "data.test_sequences=[09]"),
        *("task.max_loops=1", "task.min_improvement=null", "task.baselines=[mono,posenet]"),
    )
    assert answer.code == 0, answer.err
    summary = summary_of("run")
    assert [entry["name"] for entry in summary["baselines"]] == ["RGB SLAM", "pose network"]
    assert [entry["name"] for entry in summary["loops"]] == ["pRGBD-Initial", "pRGBD-Refined"]
    assert set(summary["loops"][1]["pose"]) == {"00", "09"}
    rows = first_column(pose_table(summary))
    at = rows.index("09, RGB SLAM")
    assert rows[at : at + 8] == [
        *(f"09, {name}" for name in ("RGB SLAM", "pose network", "pRGBD-Initial", "pRGBD-Refined")),
        *(f"09, {name} (paper)" for name in ("RGB ORB-SLAM", "pRGBD-Initial", "pRGBD-Refined")),
        "09, Monodepth2-M pose network (paper)",
    ]
    assert "09, pRGBD-Refined (paper)" in Path("run/report.html").read_text()
    assert "pRGBD-Refined (paper)" in answer.out


def test_kitti_eigen_is_refined_on_drives_and_evaluated_on_test_images(cli, kitti_raw):
    common = ("experiment=paper/kitti_eigen", f"data.root={kitti_raw / 'data'}", *SMALL)
    loop = ("task.max_loops=1", "task.min_improvement=null", "out=refined")
    images = f"evaluation.depth_test={{split: {kitti_raw / 'test_files.txt'}}}"
    answer = cli(*common, f"data.split={kitti_raw / 'train_files.txt'}", images, *loop)
    assert answer.code == 0, answer.err
    summary = summary_of("refined")
    assert summary["sequences"] == ["2011_09_26_drive_0001_sync"]
    assert summary["depth_tests"] == ["2011_09_26_drive_0002_sync"]
    assert set(summary["loops"][1]["pose"]) == {"2011_09_26_drive_0001_sync"}
    assert [loop["depth"]["images"] for loop in summary["loops"]] == [2, 2]
    with np.load("refined/loops/01/depth/samples.npz") as samples:
        assert set(samples["sequence"]) == {"2011_09_26_drive_0002_sync"}
    test = (f"data.split={kitti_raw / 'test_files.txt'}", "depth.weights=refined/weights", "task=evaluate", "out=run")
    answer = cli(*common, *test)
    assert answer.code == 0, answer.err
    depth = summary_of("run")["loops"][0]["depth"]
    assert (depth["images"], depth["crop"], depth["cap"]) == (2, "garg", [0.001, 80.0])
    assert [row["cap"] for row in depth["by_cap"]] == [30, 40, 50, 60, 70, 80]
    assert depth["by_cap"] == summary["loops"][1]["depth"]["by_cap"]  # the network that the loop kept
    rows = {row["loop"]: row for row in depth_table(summary_of("run")).rows}
    paper = rows["pRGBD-Refined (paper)"]
    assert (paper["Abs Rel"], paper["Sq Rel"]) == (0.113, 0.793)
    assert "MonoDepth2-M (paper)" in answer.out


def test_tum(cli, tmp_path):
    rendered = layouts.render("indoor-0", 640, 480, 61.7)
    prefix = "rgbd_dataset_freiburg3_"
    teddy, walking = f"{prefix}teddy", f"{prefix}walking_xyz"
    root = layouts.write_tum(tmp_path / "tum", rendered, [teddy, walking])
    answer = cli(
        *("experiment=paper/tum", f"data.root={root}", f"data.sequences=[{teddy}]", f"data.test_sequences=[{walking}]"),
        *("task.max_loops=1", "task.min_improvement=null", "data.stop=4", "out=run", *TINY),
    )
    assert answer.code == 0, answer.err
    summary = summary_of("run")
    depth = summary["loops"][1]["depth"]
    assert depth["images"] == 4  # of the test recording alone
    assert depth["cap"] == [0.001, 10.0]
    rows = first_column(pose_table(summary))
    assert {f"{walking}, RGB ORB-SLAM (paper)", f"{walking}, pRGBD-Refined (paper)"} <= set(rows)
    assert "MonoDepth2-M (paper)" in first_column(depth_table(summary))


def test_ablation_puts_the_paper_s_figures_beside_each_row(cli, kitti_raw):
    answer = cli(
        *("-m", "experiment=paper/ablation", "loss=paper_no_photometric,paper", f"data.root={kitti_raw / 'data'}"),
        *(f"data.split={kitti_raw / 'train_files.txt'}", "out=ablation", *TINY),
    )
    assert answer.code == 0, answer.err
    with open("ablation/ablation.csv", newline="") as file:
        rows = {row["run"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["loss=paper_no_photometric", "loss=paper"]
    assert (rows["loss=paper"]["Sq Rel (paper)"], rows["loss=paper_no_photometric"]["RMSE (paper)"]) == (
        "0.931",
        "4.855",
    )
    assert all(float(row["Sq Rel"]) > 0 and row["loops"] == "1" for row in rows.values())
    for suffix in ("md", "tex"):
        assert "0.931" in Path(f"ablation/ablation.{suffix}").read_text()
