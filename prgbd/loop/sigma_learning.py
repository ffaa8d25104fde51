"""Learning from SLAM's results how wrong a network's depth is, and calibrating that on keyframes it has not seen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from collections.abc import Sequence as Many
from typing import Any

import numpy as np

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.types import SlamResult
from prgbd.loop.sigma_points import SigmaPoints, joined, sigma_points
from prgbd.training.refinement_data import split_held_out
from prgbd.training.sigma_fit import calibration_factor, fit_sigma, shares_within

_MOST_POINTS = 20_000  # of all recordings; more change nothing that shows
_FEWEST_POINTS = 200  # below, a head of some hundred weights would learn the points by heart
_FEWEST_HELD_OUT = 100

Supervised = Many[tuple[Sequence, SlamResult]]


def keyframes_apart(supervised: Supervised, fraction: float) -> list[tuple[str, int]]:
    """Return recording and frame of every n-th keyframe, to be held out."""
    keyframes = [
        (sequence.name, int(frame)) for sequence, result in supervised for frame in result.keyframes.frame_index
    ]
    return [keyframes[i] for i in split_held_out(len(keyframes), fraction)[1]] if keyframes else []


def learn_sigma(
    estimator: DepthEstimator, supervised: Supervised, held_out: Iterable[tuple[str, int]]
) -> dict[str, Any] | None:
    """Fit the head that predicts the standard deviation of log depth; depth stays as it is.

    A network errs less at points that it was trained on than elsewhere. So the head learns from the keyframes that
    trained which pixels err more than others, and one factor on all of it comes from the keyframes that were held out.

    Args:
        estimator: The network, with the weights whose depth is meant.
        supervised: Recordings and what SLAM made of them.
        held_out: Recording and frame of the keyframes that the network was not trained on.

    Returns:
        ``sigma_points`` and ``sigma_held_out_points``, ``sigma_factor``, and the shares of held-out errors within one
        and two deviations, ``sigma_within_one`` and ``sigma_within_two``. None where the network has no head, or SLAM
        gives too few points.
    """
    head = estimator.sigma_head()
    if head is None:
        return None
    apart = set(held_out)
    fitted, tested = [], []
    for sequence, result in supervised:
        points = sigma_points(estimator, sequence, result, features=True, most=_MOST_POINTS // len(supervised))
        away = {frame for name, frame in apart if name == sequence.name}
        fitted.append(points.of(set(points.frame.tolist()) - away))
        tested.append(points.of(away))
    taught, unseen = joined(fitted), joined(tested)
    if len(taught) < _FEWEST_POINTS or taught.features is None:
        return None
    fit_sigma(head, taught.features, taught.errors)
    judged = unseen if len(unseen) >= _FEWEST_HELD_OUT else taught
    factor = calibration_factor(judged.errors, _sigma(head, judged))
    head.scale(factor)
    one, two = shares_within(judged.errors, _sigma(head, judged))
    return {
        "sigma_points": len(taught),
        "sigma_held_out_points": len(unseen),
        "sigma_factor": factor,
        "sigma_within_one": one,
        "sigma_within_two": two,
    }


def describe_sigma(figures: Mapping[str, Any]) -> str:
    """Return one line about what ``learn_sigma`` found."""
    one, two = figures["sigma_within_one"], figures["sigma_within_two"]
    return (
        f"  uncertainty of depth from {figures['sigma_points']} points: {one:.0%} of those held out err by less than "
        f"one deviation, {two:.0%} by less than two (normal errors: 68 % and 95 %)"
    )


def _sigma(head: Any, points: SigmaPoints) -> Any:
    return np.asarray(head.at(points.features).double().cpu().numpy())
