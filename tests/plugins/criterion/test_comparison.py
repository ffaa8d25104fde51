"""How two loops compare by SLAM's evidence."""

import pytest

from prgbd.plugins.criterion.comparison import LOST_SHARE, compare


def entry(photometric=0.1, disagreement=0.1, tracked=1.0, frames=("3", "7")):
    return {"a": {"photometric": dict.fromkeys(frames, photometric), "disagreement": disagreement, "tracked": tracked}}


@pytest.mark.parametrize(
    ("now", "index", "better"),
    [
        (entry(), 1.0, False),
        (entry(photometric=0.09), 0.9**0.5, True),
        (entry(photometric=0.11, disagreement=0.05), (1.1 * 0.5) ** 0.5, True),
        (entry(photometric=0.09, disagreement=0.12), (0.9 * 1.2) ** 0.5, False),
        (entry(photometric=0.05, tracked=1 - 1.1 * LOST_SHARE), 0.5**0.5, False),
        (entry(photometric=0.05, tracked=1 - 0.9 * LOST_SHARE), 0.5**0.5, True),
        (entry(disagreement=None, photometric=0.2), 2.0, False),
        (entry(frames=("9",), disagreement=0.05), 0.5, True),
        (entry(frames=(), disagreement=None), None, True),
    ],
)
def test_verdict(now, index, better):
    verdict = compare(entry(), now)
    assert verdict.better == better
    assert verdict.index == (None if index is None else pytest.approx(index))
    assert "->" in verdict.sentence() or index is None
    assert verdict.to_dict()["better"] == better


def test_verdict_asks_for_as_much_as_it_is_told():
    assert compare(entry(), entry(disagreement=0.08, photometric=0.08), 0.1).better
    assert not compare(entry(), entry(disagreement=0.08, photometric=0.08), 0.3).better
