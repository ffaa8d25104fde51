"""Calibration and sparsification, on errors that are drawn with known deviations."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.evaluation.uncertainty import UncertaintyEvaluation, sparsification


def drawn(seed=0, count=20000):
    random = np.random.default_rng(seed)
    sigma = random.uniform(0.05, 0.5, count)
    return random.normal(0, sigma), sigma


def result_of(errors, sigma):
    evaluation = UncertaintyEvaluation()
    evaluation.add(errors, sigma)
    return evaluation.result()


def test_true_deviations_are_calibrated_whatever_the_scale_of_the_image():
    errors, sigma = drawn()
    for scale in (0.0, 1.3):
        found = result_of(errors + scale, sigma)
        assert found["within_one"] == pytest.approx(0.683, abs=0.01)
        assert found["within_two"] == pytest.approx(0.954, abs=0.01)
        for row in found["calibration"]:
            assert row["observed"] == pytest.approx(row["nominal"], abs=0.015)


def test_deviations_of_half_the_size_are_too_sure():
    errors, sigma = drawn()
    found = result_of(errors, sigma / 2)
    assert found["within_two"] == pytest.approx(0.683, abs=0.01)
    assert all(row["observed"] < row["nominal"] for row in found["calibration"])


def test_the_area_is_none_for_the_best_order_and_one_for_a_random_one():
    errors, sigma = drawn()
    centred = np.abs(errors - np.median(errors))
    assert result_of(errors, centred)["ause"] == pytest.approx(0, abs=1e-9)
    assert result_of(errors, np.random.default_rng(5).random(len(errors)))["ause"] == pytest.approx(1, abs=0.05)
    assert result_of(errors, 1 / (centred + 1e-3))["ause"] > 1.5
    assert 0.2 < result_of(errors, sigma)["ause"] < 0.7


def test_what_is_left_is_the_mean_of_the_least_doubtful():
    left = sparsification(np.array([4.0, 1.0, 3.0, 2.0]), np.array([4.0, 1.0, 3.0, 2.0]))
    assert left[0] == 2.5
    assert left[10] == 1.5  # half of them
    assert left[-1] == 1.0


def test_images_count_where_their_truth_is_known():
    evaluation = UncertaintyEvaluation()
    truth = np.full((10, 12), 5.0, np.float32)
    truth[:5] = 0
    depth = np.full((10, 12), 7.0, np.float32)
    evaluation.add_image(truth, depth, np.full((10, 12), 0.1, np.float32))
    evaluation.add_image(np.zeros_like(truth), depth, depth)  # nothing is known
    found = evaluation.result()
    assert (found["images"], found["pixels"], found["within_one"]) == (1, 60, 1.0)
    assert found["ause"] is None  # no error, no order
    assert UncertaintyEvaluation().result() is None
