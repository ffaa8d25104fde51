"""What the recipe chooses by SLAM's evidence, and how it says so."""

import pytest

from prgbd.loop.loop_settings import SelfImprovement
from prgbd.loop.recipe import announcement, of_recordings, sentences, suspects, teacher
from prgbd.training.learning_plan import Choice
from prgbd.training.refinement_settings import RefinementSettings


def evidence(disagreement: float | None = 0.2, tracked: float = 1.0) -> dict:
    return {"disagreement": disagreement, "tracked": tracked}


def test_only_what_may_need_another_teacher_is_suspected():
    found = suspects({"a": evidence(), "b": evidence(0.45), "c": evidence(tracked=0.5), "d": evidence(None)})
    assert list(found) == ["b", "c"]
    assert "45%" in found["b"]
    assert "50%" in found["c"]


@pytest.mark.parametrize(
    ("seen", "mono", "chosen", "said"),
    [
        (evidence(), None, "pseudo_rgbd", "20%"),
        (evidence(None), None, "pseudo_rgbd", "does not refute"),
        (evidence(0.45), None, "pseudo_rgbd", "45%"),
        (evidence(0.45), 1.0, "mono", "45%"),
        (evidence(0.45), 0.97, "mono", "45%"),
        (evidence(0.45), 0.5, "pseudo_rgbd", "without depth 50%"),
        (evidence(tracked=0.5), 1.0, "mono", "without it 100%"),
        (evidence(tracked=0.5), 0.52, "pseudo_rgbd", "20%"),
    ],
)
def test_mono_teaches_where_depth_is_refuted_or_costs_frames(seen, mono, chosen, said):
    choice = teacher(seen, mono)
    assert choice.value == chosen
    assert said in choice.why


def test_recordings_of_one_mind_are_one_choice():
    choices = {"a": teacher(evidence(), None), "b": teacher(evidence(0.1), None), "c": teacher(evidence(0.4), 1.0)}
    joined = of_recordings(choices)
    assert [choice.value for choice in joined] == ["pseudo_rgbd", "mono"]
    assert joined[0].why.startswith("a, b: ")


def test_the_choices_are_two_sentences():
    teaching = Choice("task.first_teacher", "mono", "depth is refuted")
    steps = Choice("task.budget", 30, "few keyframes")
    told = sentences([teaching, steps])
    assert told == [
        "Teacher: SLAM on the images alone, for depth is refuted.",
        "Learning: task.budget=30 (few keyframes).",
    ]
    assert sentences([steps])[0].startswith("Learning")
    assert sentences([]) == []


def test_a_run_says_at_its_start_what_is_open():
    assert "decides about teacher, steps, learning rate, batch;" in announcement(
        SelfImprovement(), RefinementSettings()
    )
    given = announcement(
        SelfImprovement(first_teacher="mono"), RefinementSettings(learning_rate=1e-6, epochs=2, batch_size=3)
    )
    assert "nothing is left" in given
    assert "teacher mono" in given
