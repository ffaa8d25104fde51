"""The built-in criteria keep the contract of everybody's."""

import pytest

from prgbd import make_criterion
from prgbd.core.registry import specs
from tests.contracts import CriterionContract

from .test_comparison import entry


class TestBuiltInCriteria(CriterionContract):
    @pytest.fixture(params=[spec.id for spec in specs("criterion") if spec.origin == "built-in"])
    def criterion(self, request):
        return make_criterion(request.param)


@pytest.mark.parametrize(("name", "loss_decides", "slam_decides"), [
    ("held_out", True, False), ("slam", False, True), ("both", True, True)
])  # fmt: skip
def test_what_decides(name, loss_decides, slam_decides):
    criterion = make_criterion(name)
    assert bool(criterion.objection(1.0, 1.1, 0.0)) == loss_decides
    assert criterion.objection(1.0, 0.9, 0.0) == ""
    verdict = criterion.judge(entry(), entry(photometric=0.2), 0.0)
    assert not verdict.better
    assert verdict.decides == slam_decides


def test_the_objection_says_by_how_much():
    held_out = make_criterion("held_out")
    assert "rose from 1.00000 to 1.10000" in held_out.objection(1.0, 1.1, 0.0)
    assert "by 5.00 % where more than 10 %" in held_out.objection(1.0, 0.95, 0.1)
