"""Which SLAM teaches a refinement, with small plug-ins."""

import pytest

from prgbd.loop.lessons import prepare
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.loop_settings import LoopSettings
from prgbd.loop.pose_refinement import PoseRefinement
from prgbd.loop.store import RunStore
from prgbd.loop.summary import RunIdentity
from prgbd.training.budget import Budget
from prgbd.training.refinement_settings import RefinementSettings
from tests.loop.fakes import Sideways, Tiny, Wall


class WithoutMono(Sideways):
    modes = frozenset({"rgbd"})


class LostWithoutDepth(Sideways):
    """Finds poses for hardly any frame where there is no depth."""

    def finish(self):
        if self.mode == "mono":
            del self.frames[4:], self.poses[4:]
        return super().finish()


@pytest.fixture
def parts(tmp_path):
    """Return a loop whose first SLAM run is done."""

    def made(slam=Sideways, **options):
        identity = RunIdentity("self_improve", "slam", "depth", "data", 0)
        store = RunStore.create(tmp_path / "run", {})
        loop = LoopParts(
            estimator=Tiny(),
            make_slam=slam,
            sequences=[Wall()],
            settings=LoopSettings(**options),
            store=store,
            identity=identity,
            refinement=RefinementSettings(),
        )
        PoseRefinement(loop, 0).run()
        return loop

    return made


def evidence(disagreement):
    return {"wall": {"disagreement": disagreement, "tracked": 1.0}}


@pytest.mark.parametrize(
    ("slam", "disagreement", "teacher", "tried"),
    [
        (Sideways, 0.1, "pseudo_rgbd", False),
        (Sideways, 0.5, "mono", True),
        (WithoutMono, 0.5, "pseudo_rgbd", False),
        (LostWithoutDepth, 0.5, "pseudo_rgbd", True),
    ],
)
def test_mono_is_tried_and_teaches_where_depth_is_refuted(parts, slam, disagreement, teacher, tried):
    lesson = prepare(parts(slam), 0, evidence(disagreement))
    ((_, result),) = lesson.supervised
    assert (result.mode == "mono") == (teacher == "mono")
    assert (lesson.choices[0].option, lesson.choices[0].value) == ("task.first_teacher", teacher)
    assert (lesson.baseline is not None) == tried


def test_what_is_given_is_not_chosen(parts):
    lesson = prepare(parts(first_teacher="mono", budget=7), 0, evidence(0.1))
    assert lesson.supervised[0][1].mode == "mono"
    assert lesson.plan.budget == Budget(steps=7)
    assert not {"task.first_teacher", "task.budget"} & {choice.option for choice in lesson.choices}
