"""What a run achieved, in sentences: better or worse, and what each figure rests on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from prgbd.report.reading import compared_sequences, judged_sequences, kept_loops, loop_name, mean_pose, sum_pose

SAME = 0.01  # a change below 1 % is called no change
ALIGNMENT_WORDS = {"sim3": "Sim3 alignment", "se3": "SE3 alignment", "none": "no alignment"}


@dataclass(frozen=True)
class Change:
    """A figure before and after the loops.

    Attributes:
        before: The first loop's value.
        after: The value of the loop that the run keeps; equal to ``before`` where that is the first.
        basis: What the figure is and rests on, e.g. ``ATE RMSE, Sim3 alignment, 150/150 frames``.
        unit: ``" m"`` or empty.
    """

    before: float
    after: float
    basis: str
    unit: str = ""

    @property
    def relative(self) -> float:
        """Change in proportion to the value before; negative is better, as all figures here are errors."""
        return (self.after - self.before) / self.before if self.before else float(self.after != self.before)

    @property
    def verdict(self) -> str:
        """``better``, ``worse`` or ``same``."""
        return "same" if abs(self.relative) < SAME else "better" if self.relative < 0 else "worse"


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure with so many significant digits; a dash for None."""
    if value is None:
        return "–"
    size = abs(value)
    if size == 0:
        return "0"
    if size < 1e-4:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{max(0, digits - 1 - math.floor(math.log10(size)))}f}"


def frames_text(loop: dict[str, Any], sequences: list[str]) -> str:
    """Return ``tracked/all`` frames of some sequences."""
    return f"{sum_pose(loop, 'tracked_frames', sequences) or 0}/{sum_pose(loop, 'frames', sequences) or 0}"


def pose_change(summary: dict[str, Any]) -> Change | None:
    """Return the change of the mean ATE RMSE over the sequences that have one in the first and the kept loop.

    Where a run has test recordings the mean is over these alone.
    """
    loops = kept_loops(summary)
    if not loops:
        return None
    first, last = loops[0], loops[-1]
    judged = judged_sequences(summary)
    names = compared_sequences(first, last, judged)
    before, after = mean_pose(first, "ate_rmse", names), mean_pose(last, "ate_rmse", names)
    if before is None or after is None:
        return None
    kinds = {first["pose"][n].get("alignment") for n in names} | {last["pose"][n].get("alignment") for n in names}
    alignment = " and ".join(ALIGNMENT_WORDS.get(str(k), str(k)) for k in sorted(kinds, key=str))
    frames = {frames_text(first, names), frames_text(last, names)}
    if len(frames) == 1:
        basis = f"{frames.pop()} frames"
    else:
        basis = f"{frames_text(first, names)} frames before and {frames_text(last, names)} after"
    kind = "test sequence" if judged else "sequence"
    average = f", mean of {len(names)} {kind}s" if len(names) > 1 else f", {kind} {names[0]}" if judged else ""
    return Change(before, after, f"ATE RMSE, {alignment}, {basis}{average}", " m")


def depth_change(summary: dict[str, Any]) -> Change | None:
    """Return the change of Abs Rel between the first loop and the kept one, as far as they have depth figures."""
    kept = kept_loops(summary)
    loops = [d for d in (loop.get("depth") for loop in kept) if d]
    loops = [d for d in loops if d.get("abs_rel") is not None]
    if not loops or (len(loops) == 1 and len(kept) > 1):
        return None  # nothing to compare: "stayed the same" would be untrue
    return Change(float(loops[0]["abs_rel"]), float(loops[-1]["abs_rel"]), depth_basis(loops[-1]))


def held_out_change(summary: dict[str, Any]) -> Change | None:
    """Return what the last refinement that the run keeps did to its loss on held-out keyframes; None without any."""
    kept = kept_loops(summary)
    trained = [loop.get("training") or {} for loop in kept[:-1]]
    before, after = (trained[-1].get(f"held_out_{when}") for when in ("before", "after")) if trained else (None, None)
    if before is None or after is None:
        return None
    which = "of the refinement" if len(trained) == 1 else "of the last refinement"
    return Change(float(before), float(after), f"{which}, on keyframes that it did not learn from, without labels")


def depth_basis(depth: dict[str, Any]) -> str:
    """Return the protocol of depth figures in words."""
    parts = ["Abs Rel"]
    if depth.get("cap"):
        near, far = depth["cap"] if isinstance(depth["cap"], list | tuple) else (0.001, depth["cap"])
        parts.append(f"{near:g}–{far:g} m cap")
    if depth.get("crop") not in (None, "none"):
        parts.append(f"{depth['crop']} crop")
    if depth.get("scale_and_shift"):
        parts.append("scale and shift of inverse depth by least squares")
    else:
        parts.append("median scaling" if depth.get("median_scaling", True) else "no median scaling")
    count = depth.get("images") or 0
    parts.append(f"{count} image" + "s" * (count != 1))
    return ", ".join(parts)


def describe(summary: dict[str, Any]) -> list[str]:
    """Return the sentences that sum up a run, honest when something got worse or rests on different frames."""
    loops = summary.get("loops") or []
    failed = [f"The run failed. {summary['failed']}"] if summary.get("failed") else []
    if not loops:
        return [*failed, "The run has not finished a loop yet."]
    pose, depth = pose_change(summary), depth_change(summary)
    loops = kept_loops(summary)
    sentences = []
    if summary.get("task") == "pretrain":
        sentences += _pretraining(loops[0])
    if len(loops) == 1:
        sentences += _one_loop(loops[0], pose, depth)
    else:
        changes = [_change("pose error", pose), _change("depth error", depth)]
        told = " and the ".join(text for text in changes if text)
        rounds = len(loops) - 1
        if told:
            sentences.append(f"Over {rounds} loop{'s' * (rounds != 1)} the {told}.")
        else:
            sentences += _without_truth(loops, held_out_change(summary))
        sentences += _caveats(loops, judged_sequences(summary))
        sentences += _better_loop(loops, judged_sequences(summary))
    if pose is None:
        sentences += _missing_pose(loops)
    sentences += _recipe(summary) + _doubts(loops) + _depth_error(loops[-1]) + _stop(summary)
    return [*failed, *sentences] or ["The depth was predicted; there is no ground truth to measure it against."]


def _pretraining(loop: dict[str, Any]) -> list[str]:
    training = loop.get("training") or {}
    before, after = training.get("held_out_before"), training.get("held_out_after")
    if before is None or after is None:
        return []
    change, steps = Change(float(before), float(after), ""), f"; {training.get('steps')} steps"
    return [_held_out(change, "Pre-training", "the loss on images", steps)]


def _held_out(change: Change, who: str, what: str, details: str = "") -> str:
    verb = {"better": "lowered", "worse": "raised", "same": "hardly changed"}[change.verdict]
    return (
        f"{who} {verb} {what} that it did not learn from, which needs no labels, from {number(change.before)} to "
        f"{number(change.after)} ({percent(change.relative)}{details})."
    )


def _without_truth(loops: list[dict[str, Any]], held_out: Change | None) -> list[str]:
    """Say what can be said where nothing is known to be true: frames, held-out loss, and SLAM's own evidence."""
    last, sentences = loops[-1], []
    frames = sum_pose(last, "frames")
    if frames:
        sentences.append(
            f"SLAM with the refined network found a pose for {frames_text(last, list(last['pose']))} frames."
        )
    if held_out is not None:
        sentences.append(_held_out(held_out, "The refinement", "its loss on keyframes"))
    criterion = last.get("criterion") or {}
    changes = [
        f"{name} {number(pair['before'])} → {number(pair['now'])}"
        for key, name in (
            ("photometric", "photometric error"),
            ("disagreement", "disagreement with triangulated depth"),
        )
        if isinstance(pair := criterion.get(key), dict) and None not in (pair.get("before"), pair.get("now"))
    ]
    if changes:
        verdict = "better" if criterion.get("better") else "no better"
        sentences.append(f"By what SLAM makes of it the refined network is {verdict} ({', '.join(changes)}).")
    return sentences


def _depth_error(loop: dict[str, Any]) -> list[str]:
    """Say how wrong the network's depth was against SLAM's own triangulation, per recording; needs no true depth."""
    poses = loop.get("pose") or {}
    told = [
        f"{pose['depth_sigma']:.0%}{f' on {name}' if len(poses) > 1 else ''} "
        f"({pose['depth_shared']:.0%} of the variance shared by a frame)"
        for name, pose in poses.items()
        if pose.get("depth_sigma") is not None
    ]
    return [f"Against SLAM's triangulated points the depth errs by {', '.join(told)}."] if told else []


def _change(what: str, change: Change | None) -> str:
    if change is None:
        return ""
    before, after = number(change.before) + change.unit, number(change.after) + change.unit
    if change.verdict == "same":
        return f"{what} stayed at {after} ({change.basis})"
    verb = "fell" if change.verdict == "better" else "rose"
    return f"{what} {verb} from {before} to {after} ({percent(change.relative)}; {change.basis})"


def percent(relative: float) -> str:
    """Format a relative change as a signed percentage with a true minus sign."""
    return f"{relative:+.0%}".replace("-", "−")


def _one_loop(loop: dict[str, Any], pose: Change | None, depth: Change | None) -> list[str]:
    sentences = []
    frames, tracked = sum_pose(loop, "frames"), sum_pose(loop, "tracked_frames")
    if frames:
        subject = "The trajectory has" if loop.get("name") == "trajectory" else "SLAM found"
        sentences.append(f"{subject} a pose for {tracked or 0} of {frames} frames.")
    if pose:
        sentences.append(f"The pose error is {number(pose.after)} m ({pose.basis}).")
    if depth:
        sentences.append(f"The depth error is {number(depth.after)} ({depth.basis}).")
    return sentences


def _caveats(loops: list[dict[str, Any]], judged: list[str] | None) -> list[str]:
    first, last = loops[0], loops[-1]
    names = compared_sequences(first, last, judged)
    sentences = []
    if names and frames_text(first, names) != frames_text(last, names):
        sentences.append("The two pose errors rest on different frames, so compare them with care.")
    left_out = sorted(set(judged or ((first.get("pose") or {}) | (last.get("pose") or {}))) - set(names))
    if names and left_out:
        sentences.append(f"Without an error in both loops, and so not in the mean: {', '.join(left_out)}.")
    return sentences


def _better_loop(loops: list[dict[str, Any]], judged: list[str] | None) -> list[str]:
    """Name the loop with the lowest error where it is neither the first nor the last."""
    sentences = []
    names = compared_sequences(loops[0], loops[-1], judged)
    poses = [(mean_pose(loop, "ate_rmse", names), loop) for loop in loops if names]
    depths = [((loop.get("depth") or {}).get("abs_rel"), loop) for loop in loops]
    for what, unit, found in (("pose error", " m", poses), ("depth error", "", depths)):
        known = [(value, loop) for value, loop in found if value is not None]
        if len(known) < 3:
            continue
        value, loop = min(known, key=lambda pair: pair[0])
        if loop not in (loops[0], loops[-1]):
            sentences.append(f"The lowest {what} was {number(value)}{unit}, in loop {loop.get('loop')}.")
    return sentences


def _doubts(loops: list[dict[str, Any]]) -> list[str]:
    """Say what speaks against the trajectories; of the loops with the same doubts the first is named."""
    found: dict[str, str] = {}
    for loop in loops:
        for name, figures in (loop.get("pose") or {}).items():
            doubts = "; ".join(str(doubt).rstrip(".") for doubt in figures.get("doubts") or ())
            if doubts:
                found.setdefault(doubts, f"{loop_name(loop)}, {name}")
    return [f"Doubtful ({where}): {doubts}." for doubts, where in found.items()]


def _missing_pose(loops: list[dict[str, Any]]) -> list[str]:
    """Say why there is no pose error; of the loops with the same reason the last, which the run keeps, is named."""
    reasons: dict[str, str] = {}
    for loop in reversed(loops):
        for name, figures in (loop.get("pose") or {}).items():
            if figures.get("ate_rmse") is None and figures.get("reason"):
                reasons.setdefault(figures["reason"], f"{loop_name(loop)}, {name}")
    return [f"No pose error ({where}): {reason}" for reason, where in reasons.items()]


def _recipe(summary: dict[str, Any]) -> list[str]:
    """Say who taught the network first, how it learnt, and what speaks for the loop that is kept; needs no labels."""
    recipe, kept = summary.get("recipe") or [], kept_loops(summary)
    if not recipe:
        return []
    index = (kept[-1].get("criterion") or {}).get("index") if len(kept) > 1 else None
    because = "" if index is None else f", for SLAM's evidence, free of labels, is {number(index)} of what it was"
    return [*(recipe[0].get("sentences") or []), f"Kept: {loop_name(kept[-1])}{because}."]


def _stop(summary: dict[str, Any]) -> list[str]:
    stop = summary.get("stop") or {}
    sentences = []
    if stop.get("reason"):
        reason = str(stop["reason"]).strip()
        sentences.append(reason[:1].upper() + reason[1:].rstrip(".") + ".")
    best, loops = stop.get("best_loop"), summary.get("loops") or []
    if best is not None and len(loops) > 1 and best != loops[-1].get("loop"):
        sentences.append(f"The stop rule, which sees no ground truth, keeps the result of loop {best}.")
    return sentences
