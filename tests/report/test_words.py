import copy

import pytest

from prgbd.io.files import read_json
from prgbd.report.words import describe, held_out_change, number, pose_change


@pytest.fixture
def summary(run_folder):
    return copy.deepcopy(read_json(run_folder / "summary.json"))


def only(summary, *loops):
    summary["loops"] = [summary["loops"][k] for k in loops]
    return summary


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (0, "0"), (0.5178, "0.518"), (12.345, "12.3"), (145.23, "145"), (1234.5, "1,234"),
     (0.00253, "0.00253"), (1.5e-6, "1.50e-06"), (-0.25, "-0.250"), (99.96, "100.0")],
)  # fmt: skip
def test_numbers_have_three_significant_digits(value, text):
    assert number(value) == text


def test_better_is_said_with_what_the_figures_rest_on(summary):
    text = describe(summary)
    assert text[0].startswith("Over 2 loops the pose error fell from ")
    assert "ATE RMSE, Sim3 alignment, 147/150 frames before and 150/150 after" in text[0]
    assert " and the depth error fell from " in text[0]
    assert "Abs Rel, 0.001–80 m cap, median scaling, 3 images" in text[0]
    assert "The two pose errors rest on different frames, so compare them with care." in text
    assert "The 2 refinements that task.max_loops allows were made." in text
    assert not any("keeps the result" in s for s in text)


def test_the_recipe_is_three_sentences(summary):
    assert not any(text.startswith("Kept:") for text in describe(summary))
    told = ["Teacher: SLAM on the images alone, for a reason.", "Learning: task.budget=30 (few keyframes)."]
    summary["recipe"] = [{"loop": 0, "choices": [], "sentences": told}, {"loop": 1, "choices": [], "sentences": ["x"]}]
    summary["loops"][-1]["criterion"] = {"index": 0.5}
    text = describe(summary)
    kept = f"Kept: {summary['loops'][-1]['name']}, for SLAM's evidence, free of labels, is 0.500 of what it was."
    at = text.index(told[0])
    assert text[at : at + 3] == [*told, kept]


def test_worse_is_called_worse_and_the_same_is_called_the_same(summary):
    first = only(summary, 0, 1)
    worse = copy.deepcopy(first)
    worse["loops"].reverse()
    text = describe(worse)[0]
    assert text.startswith("Over 1 loop the pose error rose from ")
    assert "the depth error rose from" in text
    assert pose_change(worse).verdict == "worse"
    same = copy.deepcopy(first)
    same["loops"][1]["pose"] = same["loops"][0]["pose"]
    same["loops"][1]["depth"]["abs_rel"] = same["loops"][0]["depth"]["abs_rel"] * 1.004
    text = describe(same)[0]
    assert "pose error stayed at" in text
    assert "depth error stayed at" in text


def test_the_loop_that_the_stop_rule_keeps_is_named_if_it_is_not_the_last(summary):
    summary["stop"] = {"reason": "no improvement", "best_loop": 1}
    assert describe(summary)[-2:] == [
        "No improvement.",
        "The stop rule, which sees no ground truth, keeps the result of loop 1.",
    ]


def test_a_better_loop_in_between_is_named(summary):
    summary["loops"][1]["pose"]["street-a"]["ate_rmse"] = 0.001
    assert "The lowest pose error was 0.00100 m, in loop 1." in describe(summary)


def test_means_take_only_sequences_that_have_both(summary):
    for loop in summary["loops"]:
        loop["pose"]["b"] = dict(loop["pose"]["street-a"])
    summary["loops"][0]["pose"]["b"]["ate_rmse"] = None
    change = pose_change(summary)
    assert change.before == summary["loops"][0]["pose"]["street-a"]["ate_rmse"]
    assert "Without an error in both loops, and so not in the mean: b." in describe(summary)


def test_without_truth_the_reason_is_given(summary):
    only(summary, 0)
    summary["loops"][0]["depth"] = None
    summary["loops"][0]["pose"]["street-a"] |= {"ate_rmse": None, "reason": "There is no ground truth."}
    text = " ".join(describe(summary))
    assert "SLAM found a pose for 147 of 150 frames." in text
    assert "No pose error (pRGBD-Initial, street-a): There is no ground truth." in text
    assert "fell" not in text


def test_the_loop_that_is_kept_is_named_where_none_has_a_pose_error(summary):
    for loop in summary["loops"]:
        loop["pose"]["street-a"] |= {"ate_rmse": None, "reason": "There is no ground truth."}
    summary["stop"]["best_loop"] = 1
    summary["loops"][1]["name"] = "the kept one"
    assert "No pose error (the kept one, street-a): There is no ground truth." in describe(summary)


def test_depth_of_one_loop_alone_is_no_change(summary):
    summary["loops"][0]["depth"] = summary["loops"][1]["depth"] = None
    assert "depth" not in " ".join(describe(summary))


def test_a_run_without_loops_is_described():
    assert describe({"loops": []}) == ["The run has not finished a loop yet."]
    assert describe({}) == ["The run has not finished a loop yet."]


def test_the_depths_error_against_the_map_is_told_where_there_is_one():
    def sentences(**errors):
        pose = {
            name: {"frames": 9, "tracked_frames": 9, "depth_sigma": sigma, "depth_shared": 0.6}
            for name, sigma in errors.items()
        }
        return describe({"loops": [{"loop": 0, "pose": pose, "depth": None}]})

    told = "Against SLAM's triangulated points the depth errs by 14% (60% of the variance shared by a frame)."
    assert told in sentences(a=0.142)
    assert any("14% on a (60%" in sentence for sentence in sentences(a=0.142, b=None))
    assert not any("errs" in sentence for sentence in sentences(a=None))


def test_the_pose_error_is_that_of_the_test_recordings_where_there_are_some(summary):
    for loop in summary["loops"]:
        learnt = loop["pose"]["street-a"]
        loop["pose"]["street-b"] = learnt | {"ate_rmse": 2 * learnt["ate_rmse"]}
    assert "mean of 2 sequences" in pose_change(summary).basis
    summary["test_sequences"] = ["street-b"]
    change = pose_change(summary)
    assert change.after == 2 * summary["loops"][-1]["pose"]["street-a"]["ate_rmse"]
    assert change.basis.endswith(", test sequence street-b")
    assert not any("not in the mean" in sentence for sentence in describe(summary))


def test_without_truth_the_held_out_loss_and_slam_s_evidence_are_told(summary):
    for loop in summary["loops"]:
        loop["depth"] = None
        loop["pose"] = {
            n: p | {"ate_rmse": None, "reason": "There is no ground truth."} for n, p in loop["pose"].items()
        }
    evidence = {"photometric": {"before": 0.08, "now": 0.07}, "disagreement": {"before": 0.3, "now": None}}
    summary["loops"][-1]["criterion"] = {"better": True, **evidence}
    text = describe(summary)
    assert text[0] == "SLAM with the refined network found a pose for 150/150 frames."
    training = summary["loops"][1]["training"]
    before, after = number(training["held_out_before"]), number(training["held_out_after"])
    assert text[1].startswith("The refinement lowered its loss on keyframes that it did not learn from")
    assert f"from {before} to {after} (−22%)" in text[1]
    assert text[2] == ("By what SLAM makes of it the refined network is better (photometric error 0.0800 → 0.0700).")
    assert any("There is no ground truth." in sentence for sentence in text[3:])
    summary["loops"] = summary["loops"][:1]
    assert held_out_change(summary) is None


def test_a_run_that_measured_nothing_still_has_a_sentence(summary):
    loop = {"loop": 0, "name": "depth", "pose": {}, "depth": None, "training": None}
    assert describe({"task": "depth", "loops": [loop]}) == [
        "The depth was predicted; there is no ground truth to measure it against."
    ]
    training = {"held_out_before": 0.2, "held_out_after": 0.1, "steps": 40}
    assert describe({"task": "pretrain", "loops": [loop | {"training": training}]}) == [
        "Pre-training lowered the loss on images that it did not learn from, which needs no labels, "
        "from 0.200 to 0.100 (−50%; 40 steps)."
    ]
    only(summary, 0)["loops"][0]["name"] = "trajectory"
    assert describe(summary)[0] == "The trajectory has a pose for 147 of 150 frames."


def test_doubts_are_told_once(summary):
    for loop in summary["loops"]:
        loop["pose"]["street-a"]["doubts"] = ["the depth is 5 times too small", "the camera jumps at frame 3"]
    told = [sentence for sentence in describe(summary) if sentence.startswith("Doubtful")]
    assert told == ["Doubtful (pRGBD-Initial, street-a): the depth is 5 times too small; the camera jumps at frame 3."]
