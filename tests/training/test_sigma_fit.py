"""Fitting a head by likelihood, and the one factor of calibration."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prgbd.core.sigma_head import SigmaHead
from prgbd.training.sigma_fit import ONE_SIGMA, TWO_SIGMA, calibration_factor, fit_sigma, shares_within


def test_the_deviations_of_laplacian_errors_are_found_again():
    random = np.random.default_rng(0)
    features = random.normal(3, 2, (20000, 3)).astype(np.float32)
    truth = np.exp(-2 + features @ [0.3, -0.2, 0.0])
    errors = random.laplace(0, truth / np.sqrt(2))
    head = SigmaHead([3])
    fit_sigma(head, torch.from_numpy(features), np.abs(errors))
    ratio = head.at(torch.from_numpy(features)).numpy() / truth
    lowest, middle, highest = np.quantile(ratio, [0.05, 0.5, 0.95])
    assert 0.8 < lowest < middle < highest < 1.25
    assert middle == pytest.approx(1, abs=0.03)
    again = SigmaHead([3])
    fit_sigma(again, torch.from_numpy(features), np.abs(errors))
    assert torch.equal(head.weight, again.weight)


def test_a_feature_that_never_changes_has_no_say():
    features = torch.ones(500, 2)
    head = SigmaHead([2])
    fit_sigma(head, features, np.full(500, 0.1))
    assert torch.isfinite(head.at(features)).all()
    assert head.at(features[0]).item() == pytest.approx(0.1 * np.sqrt(2), rel=0.01)


@pytest.mark.parametrize("true", [0.3, 1.0, 2.5])
def test_the_factor_of_normal_errors_is_found(true):
    errors = np.random.default_rng(1).normal(0, 0.2 * true, 40000)
    factor = calibration_factor(errors, np.full(40000, 0.2))
    assert factor == pytest.approx(true, rel=0.02)
    assert shares_within(errors, np.full(40000, 0.2 * factor)) == pytest.approx((ONE_SIGMA, TWO_SIGMA), abs=0.01)


def test_heavy_tails_share_the_miss_between_one_and_two_deviations():
    errors = np.random.default_rng(2).standard_t(2, 40000)
    sigma = np.ones(40000)
    one, two = shares_within(errors, sigma * calibration_factor(errors, sigma))
    assert one - ONE_SIGMA == pytest.approx(TWO_SIGMA - two, abs=0.01)
