"""Contract tests that every plug-in inherits: derive a class and give it the one fixture."""

from __future__ import annotations

import pytest

from prgbd import (
    check_augmentation,
    check_criterion,
    check_depth_estimator,
    check_loss,
    check_sequence,
    check_slam,
)


class DepthContract:
    """Derive and define the fixture ``estimator``."""

    @pytest.fixture
    def estimator(self):
        raise NotImplementedError("define the fixture 'estimator'")

    def test_keeps_the_depth_contract(self, estimator) -> None:
        check_depth_estimator(estimator)


class SequenceContract:
    """Derive and define the fixture ``sequence``."""

    @pytest.fixture
    def sequence(self):
        raise NotImplementedError("define the fixture 'sequence'")

    def test_keeps_the_sequence_contract(self, sequence) -> None:
        check_sequence(sequence)


class SlamContract:
    """Derive and define the fixture ``system``."""

    @pytest.fixture
    def system(self):
        raise NotImplementedError("define the fixture 'system'")

    def test_keeps_the_slam_contract(self, system) -> None:
        result = check_slam(system)
        assert result.frames == len(result.states)


class LossContract:
    """Derive and define the fixture ``term``."""

    @pytest.fixture
    def term(self):
        raise NotImplementedError("define the fixture 'term'")

    def test_keeps_the_loss_contract(self, term) -> None:
        check_loss(term)


class CriterionContract:
    """Derive and define the fixture ``criterion``."""

    @pytest.fixture
    def criterion(self):
        raise NotImplementedError("define the fixture 'criterion'")

    def test_keeps_the_criterion_contract(self, criterion) -> None:
        check_criterion(criterion)


class AugmentationContract:
    """Derive and define the fixture ``augmentation``."""

    @pytest.fixture
    def augmentation(self):
        raise NotImplementedError("define the fixture 'augmentation'")

    def test_keeps_the_augmentation_contract(self, augmentation) -> None:
        check_augmentation(augmentation)
