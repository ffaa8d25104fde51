"""Thorough checks of what a refinement is made of: loss terms, criteria and augmentations.

As in ``conformance``: each function raises ``ContractError`` with one sentence at the first breach.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from prgbd.core.criterion import Criterion, Evidence, Verdict
from prgbd.core.refinement_batch import RefinementBatch, View
from prgbd.core.testing.check import Check
from prgbd.core.types import DepthPrediction
from prgbd.core.validation import check_augmented, check_loss_value, require

if TYPE_CHECKING:
    from torch import Tensor

    from prgbd.core.augmentation import Augmentation
    from prgbd.core.loss import LossTerm

SEED = 5


def check_loss(term: LossTerm) -> None:
    """Check a loss term: a finite scalar, the same for the same seed, whose gradient reaches the predicted depth.

    Args:
        term: The term.

    Raises:
        ContractError: At the first breach of ``prgbd.LossTerm``.
    """
    for check in loss_checks(term):
        check.run()


def check_augmentation(augmentation: Augmentation) -> None:
    """Check an augmentation: shapes, the same for the same seed, and a geometry that stays consistent.

    Args:
        augmentation: The augmentation.

    Raises:
        ContractError: At the first breach of ``prgbd.Augmentation``.
    """
    for check in augmentation_checks(augmentation):
        check.run()


def check_criterion(criterion: Criterion) -> None:
    """Check a criterion: sound answers, the same twice, also where little could be measured.

    Args:
        criterion: The criterion.

    Raises:
        ContractError: At the first breach of ``prgbd.Criterion``.
    """
    for check in criterion_checks(criterion):
        check.run()


def loss_checks(term: LossTerm) -> list[Check]:
    """Return the checks of a loss term."""
    return _LossChecks(term).all()


def augmentation_checks(augmentation: Augmentation) -> list[Check]:
    """Return the checks of an augmentation."""
    return _AugmentationChecks(augmentation).all()


def criterion_checks(criterion: Criterion) -> list[Check]:
    """Return the checks of a criterion."""
    return _CriterionChecks(criterion).all()


class _LossChecks:
    """The checks of a loss term, on depth that errs by some percent."""

    def __init__(self, term: LossTerm) -> None:
        self.term = term
        self.who = f"The loss term {type(term).__name__}"

    def all(self) -> list[Check]:
        checks = [
            Check("declares its views and a weight", self._declarations),
            Check("forward: a finite scalar, the same for the same seed; the batch stays as it is", self._forward),
            Check("forward: finite gradients reach the predicted depth", self._gradients),
            Check("forward: the gradient agrees with finite differences", self._differences),
            Check("forward: samples without points, a batch of one, depth at half the size", self._odd_batches),
        ]
        return checks if self.term.exact_gradient else [c for c in checks if c.run != self._differences]

    def _declarations(self) -> None:
        from prgbd.core.loss import LossTerm

        require(isinstance(self.term, LossTerm), self.who, "is no subclass of prgbd.LossTerm.")
        views = self.term.views
        known = bool(views) and all(isinstance(view, View) for view in views) and list(views) == sorted(set(views))
        require(known, self.who, f"declares views={views!r}; it must be a tuple of prgbd.View, ascending.")
        weight = self.term.weight
        require(weight >= 0, self.who, f"has a weight of {weight!r}; pass it to super().__init__.")

    def _scene(self, *, double: bool = False, samples: int = 2) -> tuple[RefinementBatch, Tensor]:
        """Return a batch and depth maps of the views of the term that are wrong by up to a tenth."""
        import torch

        from prgbd.core.testing.refinement_scene import refinement_scene

        batch, depths = refinement_scene(samples, dtype=torch.float64 if double else torch.float32)
        depth = torch.cat([depths[view] for view in self.term.views])
        noise = torch.rand(depth.shape, generator=torch.Generator().manual_seed(SEED), dtype=depth.dtype)
        return batch, depth * (0.9 + 0.2 * noise)

    def _value(self, batch: RefinementBatch, depth: Tensor, *, small: bool = False) -> Tensor:
        import torch

        from prgbd.core.loss import LossInputs

        halved = 1 / torch.nn.functional.avg_pool2d(1 / depth, 2)
        depths = (halved,) if small else (depth, halved)
        prediction = DepthPrediction(depths, tuple(1 / d for d in depths))
        inputs = LossInputs(batch, self.term.views, prediction, torch.Generator().manual_seed(SEED))
        value: Tensor = self.term(inputs)
        return value

    def _finite(self, value: Tensor, where: str) -> None:
        import torch

        check_loss_value(value, self.who)
        require(torch.isfinite(value), self.who, f"gives {value.item()} {where}; it must be finite.")

    def _forward(self) -> None:
        batch, depth = self._scene()
        before = _copy(batch)
        value = self._value(batch, depth)
        self._finite(value, "on a plain scene")
        same = value.equal(self._value(batch, depth))
        require(same, self.who, "gives another value for the same seed; draw from the generator of the inputs.")
        require(_same(batch, before), self.who, "changes the batch, which other terms use as well.")

    def _gradients(self) -> None:
        import torch

        batch, depth = self._scene()
        depth.requires_grad_()
        value = self._value(batch, depth)
        require(value.requires_grad, self.who, "gives no gradient; is depth detached?")
        (gradient,) = torch.autograd.grad(value, depth)
        require(torch.isfinite(gradient).all(), self.who, "gives gradients that are not finite.")
        require(gradient.abs().sum() > 0, self.who, "gives a gradient that is zero everywhere.")

    def _differences(self) -> None:
        import torch

        batch, depth = self._scene(double=True)
        agrees = torch.autograd.gradcheck(
            partial(self._value, batch), depth.requires_grad_(), fast_mode=True, raise_exception=False, rtol=0.01
        )
        require(
            agrees,
            self.who,
            "gives a gradient that finite differences refute; compute in the type of the depth, or declare "
            "exact_gradient = False where some of it is held back on purpose.",
        )

    def _odd_batches(self) -> None:
        import torch

        batch, depth = self._scene()
        none = torch.zeros_like(batch.mask)
        self._finite(self._value(batch._replace(mask=none, seen_mask=none), depth), "where no point was seen")
        empty = {"uv": batch.uv[:, :, :0], "depth": batch.depth[:, :, :0], "mask": none[:, :0]}
        seen = {"seen_uv": batch.seen_uv[:, :0], "seen_depth": batch.seen_depth[:, :0], "seen_mask": none[:, :0]}
        self._finite(self._value(batch._replace(**empty, **seen), depth), "without any points")
        self._finite(self._value(*self._scene(samples=1)), "for a batch of one")
        self._finite(self._value(batch, depth, small=True), "for depth of half the images' size")


class _AugmentationChecks:
    """The checks of an augmentation."""

    def __init__(self, augmentation: Augmentation) -> None:
        self.augmentation = augmentation
        self.who = f"The augmentation {type(augmentation).__name__}"

    def all(self) -> list[Check]:
        return [
            Check("declares a probability", self._declarations),
            Check("augment: shapes and types stay, images in [0, 1], the given batch as it was", self._shapes),
            Check("augment: samples that were not chosen stay as they are", self._chosen),
            Check("augment: the same for the same seed", self._seed),
            Check("augment: points, cameras, motions and images still agree", self._geometry),
        ]

    def _declarations(self) -> None:
        from prgbd.core.augmentation import Augmentation

        require(isinstance(self.augmentation, Augmentation), self.who, "is no subclass of prgbd.Augmentation.")
        probability = self.augmentation.probability
        require(0 <= probability <= 1, self.who, f"has a probability of {probability!r}; call super().__init__.")

    def _augmented(self, *chosen: bool, batch: RefinementBatch | None = None) -> RefinementBatch:
        import torch

        batch = _scene() if batch is None else batch
        return self.augmentation.augment(batch, torch.tensor(chosen), torch.Generator().manual_seed(SEED))

    def _shapes(self) -> None:
        batch = _scene()
        before = _copy(batch)
        augmented = self._augmented(True, True, batch=batch)
        check_augmented(augmented, batch, self.who)
        for name in ("images", "inputs"):
            images = getattr(augmented, name)
            require(images.min() >= 0 and images.max() <= 1, self.who, f"gives {name} beyond [0, 1]; clamp them.")
        require(_same(batch, before), self.who, "changes the batch that it is given; work on copies.")

    def _chosen(self) -> None:
        batch = _scene()
        none, first = self._augmented(False, False), self._augmented(True, False)
        require(_same(none, batch), self.who, "changes samples although none was chosen.")
        second = [(x[1], y[1]) for x, y in zip(_tensors(first), _tensors(batch), strict=True)]
        require(all(x.equal(y) for x, y in second), self.who, "changes a sample that was not chosen.")

    def _seed(self) -> None:
        same = _same(self._augmented(True, True), self._augmented(True, True))
        require(same, self.who, "gives another batch for the same seed; draw from the generator.")

    def _geometry(self) -> None:
        from prgbd.core.testing.refinement_scene import colours_at, points_in

        batch = self._augmented(True, True)
        for view in View:
            if view == View.CURRENT:
                continue
            uv, depth = points_in(batch, view)
            if view >= View.KEYFRAME_1:
                row = view - View.KEYFRAME_1 + 1
                off = max((uv - batch.uv[:, row]).abs().max(), (depth - batch.depth[:, row]).abs().max())
                require(off < 0.01, self.who, f"moves the points away from where {view!r} sees them.")
            here, there = colours_at(batch.images[:, 0], batch.uv[:, 0]), colours_at(batch.images[:, view], uv)
            agree = (here - there).abs().max() < 0.05
            require(agree, self.who, f"breaks the agreement between images and the motion to {view!r}.")


class _CriterionChecks:
    """The checks of a criterion."""

    def __init__(self, criterion: Criterion) -> None:
        self.criterion = criterion
        self.who = f"The criterion {type(criterion).__name__}"

    def all(self) -> list[Check]:
        return [
            Check("objection: a sentence or nothing", self._objection),
            Check("judge: a sound verdict, the same twice", self._verdict),
            Check("judge: a loop that is worse in everything is not called better", self._worse),
            Check("judge: works where nothing could be measured", self._nothing),
        ]

    def _objection(self) -> None:
        require(isinstance(self.criterion, Criterion), self.who, "is no subclass of prgbd.Criterion.")
        for before, after in ((1.0, 0.5), (1.0, 1.0), (0.5, 1.0), (0.0, 0.0)):
            said = self.criterion.objection(before, after, 0.01)
            require(isinstance(said, str), self.who, f"answers {said!r} in objection; it must be a sentence, or ''.")

    def _judged(self, best: Evidence, now: Evidence) -> Verdict:
        verdict = self.criterion.judge({"a": best, "b": best}, {"a": now, "b": now}, 0.01)
        kind = type(verdict).__name__
        require(isinstance(verdict, Verdict), self.who, f"answers a {kind} in judge; it must be a prgbd.Verdict.")
        return verdict

    def _verdict(self) -> None:
        best, now = _evidence(0.1), _evidence(0.08)
        verdict = self._judged(best, now)
        require(verdict == self._judged(best, now), self.who, "judges the same loops differently the second time.")
        require(bool(verdict.sentence()), self.who, "gives a verdict without words.")
        try:
            json.dumps(verdict.to_dict())
        except (TypeError, ValueError):
            require(False, self.who, "gives a verdict of values that JSON cannot hold; use plain numbers.")

    def _worse(self) -> None:
        verdict = self._judged(_evidence(0.1), _evidence(0.4, tracked=0.5))
        require(not (verdict.decides and verdict.better), self.who, "calls a loop better that is worse in everything.")

    def _nothing(self) -> None:
        self._judged(_evidence(None), _evidence(None))
        self._judged(_evidence(0.1), _evidence(None, tracked=0.0))


def _evidence(error: float | None, tracked: float = 1.0) -> Evidence:
    frames = ("3", "7", "11") if error is not None else ()
    return {
        "tracked": tracked,
        "maps": 1,
        "inliers": None if error is None else 100 * tracked,
        "reprojection": error,
        "disagreement": error,
        "scale_wander": error,
        "photometric": dict.fromkeys(frames, error or 0.0),
    }


def _scene() -> RefinementBatch:
    from prgbd.core.testing.refinement_scene import refinement_scene

    return refinement_scene()[0]


def _tensors(batch: RefinementBatch) -> list[Tensor]:
    return list(batch._replace(altered=batch.inputs))  # type: ignore[arg-type]


def _copy(batch: RefinementBatch) -> RefinementBatch:
    return RefinementBatch(*(tensor.clone() for tensor in _tensors(batch)))


def _same(a: RefinementBatch, b: RefinementBatch) -> bool:
    return all(x.equal(y) for x, y in zip(_tensors(a), _tensors(b), strict=True))


CHECKS: dict[str, Callable[..., list[Check]]] = {
    "loss": loss_checks,
    "criterion": criterion_checks,
    "augmentation": augmentation_checks,
}
