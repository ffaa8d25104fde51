"""The curves of uncertainty, and its maps beside the depth."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.evaluation.uncertainty import UncertaintyEvaluation
from prgbd.report.drawing import to_bytes
from prgbd.report.pictures import depth_rows
from prgbd.report.reading import DepthSamples, Run
from prgbd.report.summary_schema import check_summary
from prgbd.report.uncertainty import uncertainty_curves


def figures(seed):
    evaluation, random = UncertaintyEvaluation(), np.random.default_rng(seed)
    sigma = random.uniform(0.1, 0.4, 500)
    evaluation.add(random.normal(0, sigma), sigma)
    return evaluation.result()


def run(tmp_path, *uncertainties):
    loops = [{"loop": i, "name": f"loop {i}", "uncertainty": found} for i, found in enumerate(uncertainties)]
    return Run(tmp_path, check_summary({"loops": loops}, "summary.json"))


def test_both_curves_by_what_depth_is_compared_with(tmp_path):
    found = uncertainty_curves(run(tmp_path, {"truth": figures(0), "points": figures(1)}, {"truth": figures(2)}))
    assert [drawing.name for drawing in found] == [
        "calibration-truth",
        "sparsification-truth",
        "calibration-points",
        "sparsification-points",
    ]
    both, alone = found[0].figure.axes[0], found[2].figure.axes[0]
    assert len(both.lines) == 3  # the diagonal, the first and the last loop
    assert len(alone.lines) == 2
    sparse = found[1].figure.axes[0]
    left, least = sparse.lines[0].get_ydata(), sparse.lines[2].get_ydata()
    assert left[0] == pytest.approx(least[0])
    assert (np.asarray(left) >= np.asarray(least) - 1e-9).all()
    assert b"<svg" in to_bytes(found[0].figure, "svg")


def test_networks_without_uncertainty_have_no_curves(tmp_path):
    assert uncertainty_curves(run(tmp_path, None, {})) == []


def test_maps_of_uncertainty_lie_beside_the_depth():
    depth = np.full((1, 8, 12), 4.0, np.float32)
    images = np.zeros((1, 8, 12, 3), np.uint8)
    samples = DepthSamples(images, depth, None, [("a", 0)], np.linspace(0, 0.5, 96, dtype=np.float32).reshape(1, 8, 12))
    with_map, without = (depth_rows([("first", s)]) for s in (samples, DepthSamples(images, depth, None, [("a", 0)])))
    picture = with_map[0].predictions[0].sigma_picture
    assert picture.shape == (8, 12, 3)
    assert picture[0, 1].sum() < picture[-1, -1].sum()  # dark is sure
    assert with_map[0].has_sigma
    assert not without[0].has_sigma
