"""The help of options says what the docstrings of their dataclasses say."""

from prgbd.cli.option_help import _all_rows


def test_every_option_says_what_it_means():
    assert [key for _, key, _, meaning in _all_rows() if not meaning] == []


def test_the_options_of_a_group_are_shown_with_defaults_and_meanings(cli):
    answer = cli("--help", "training")
    assert answer.code == 0
    for words in ("training.batch_size=auto", "Keyframes per step", "training.align_scale=null"):
        assert words in answer.out
    assert "pretraining." not in answer.out


def test_one_option_of_several_tasks_and_groups_of_a_plugin_are_shown(cli):
    shown = cli("-h", "task.max_loops", "slam.tracking", "sensing.precision").out
    for words in ("task.max_loops=1", "slam.tracking.restart_after=", "sensing.precision=float32"):
        assert words in shown


def test_an_unknown_name_answers_with_the_nearest(cli):
    answer = cli("--help", "training.lr")
    assert answer.code == 2
    assert "'training.learning_rate'" in answer.sentence
