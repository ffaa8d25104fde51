"""What "auto" becomes for a refinement, and the budgets that end one."""

from types import SimpleNamespace

import pytest

from prgbd.core.errors import ConfigError
from prgbd.io.files import read_json
from prgbd.training import timed_steps
from prgbd.training.budget import Budget, check_ends, read_budget
from prgbd.training.learning_plan import learning_plan
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.timed_steps import TIMED, WARM_UP, TimedSteps


@pytest.mark.parametrize(
    ("given", "budget"),
    [
        ("auto", None),
        (500, Budget(steps=500)),
        ("500", Budget(steps=500)),
        ("90s", Budget(seconds=90.0)),
        ("10min", Budget(seconds=600.0)),
        ("1.5 h", Budget(seconds=5400.0)),
    ],
)
def test_a_budget_is_steps_or_a_time(given, budget):
    assert read_budget(given) == budget


@pytest.mark.parametrize("wrong", ["", "soon", "0", "0min", "-3", "1.5", "10 days", "1e3", 10**12])
def test_what_is_no_budget_is_refused(wrong):
    with pytest.raises(ConfigError, match=r"task\.budget"):
        read_budget(wrong)


def test_budget_and_epochs_exclude_each_other():
    check_ends("auto", 3)
    check_ends("1h", "auto")
    with pytest.raises(ConfigError, match=r"task\.budget=1h and training\.epochs=3"):
        check_ends("1h", 3)


@pytest.mark.parametrize(
    ("keyframes", "batch", "steps"),
    [(2, 2, 30), (8, 4, 30), (40, 4, 100), (115, 4, 288), (500, 4, 300), (3599, 4, 300), (9000, 12, 300)],
)
def test_steps_and_batch_follow_the_keyframes(keyframes, batch, steps):
    plan = learning_plan(RefinementSettings(), keyframes)
    assert (plan.settings.batch_size, plan.budget) == (batch, Budget(steps=steps))
    assert [choice.option for choice in plan.choices] == [
        "training.learning_rate",
        "training.batch_size",
        "task.budget",
    ]


def test_a_network_that_triangulation_refutes_learns_faster():
    known, strange = (learning_plan(RefinementSettings(), 50, None, wrong) for wrong in (0.2, 0.4))
    assert known.settings.learning_rate < strange.settings.learning_rate
    assert "40%" in strange.choices[0].why


def test_what_is_given_is_kept():
    given = RefinementSettings(learning_rate=1e-6, epochs=1, batch_size=12)
    plan = learning_plan(given, 50, None, 0.4)
    assert (plan.settings, plan.budget, plan.choices) == (given, None, ())
    timed = learning_plan(RefinementSettings(), 50, Budget(seconds=60))
    assert timed.budget == Budget(seconds=60)


def trainer(step: int = 0) -> SimpleNamespace:
    loop = SimpleNamespace(max_steps=-1)
    made = SimpleNamespace(
        fit_loop=SimpleNamespace(epoch_loop=loop),
        strategy=SimpleNamespace(broadcast=lambda value: value),
        is_global_zero=True,
        accumulate_grad_batches=1,
        global_step=step,
    )
    made.loop = loop
    return made


def test_a_time_becomes_a_number_of_steps_that_a_resumed_training_takes_over(tmp_path, monkeypatch):
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(timed_steps.time, "perf_counter", lambda: clock.now)
    first, callback = trainer(), TimedSteps(60.0, tmp_path, "key")
    callback.on_fit_start(first, None)
    for step in range(WARM_UP + TIMED):
        first.max_steps = first.loop.max_steps
        callback.on_train_batch_start(first, None, None, step)
        clock.now += 30.0 if step < WARM_UP else 0.5
        callback.on_train_batch_end(first, None, None, None, step)
    assert first.loop.max_steps == 120
    assert read_json(tmp_path / "steps.json")["steps"] == 120
    again, other = trainer(), trainer()
    TimedSteps(60.0, tmp_path, "key").on_fit_start(again, None)
    TimedSteps(60.0, tmp_path, "another key").on_fit_start(other, None)
    assert (again.loop.max_steps, other.loop.max_steps) == (120, -1)
