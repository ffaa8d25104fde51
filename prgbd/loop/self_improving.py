"""``SelfImprovingLoop``: SLAM on the network's depth, the network refined on SLAM's output, and again."""

from __future__ import annotations

import math
from typing import Any

from prgbd.core.criterion import Criterion, Evidence
from prgbd.core.depth import weights_fingerprint
from prgbd.core.errors import ConfigError
from prgbd.core.registry import make_criterion
from prgbd.loop.baselines import run_baseline
from prgbd.loop.lessons import Lesson, prepare
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.outcome import Failures
from prgbd.loop.pose_refinement import PoseRefinement, loop_name, step_name
from prgbd.loop.recipe import announcement, plain, sentences
from prgbd.loop.refining import refine_in_run
from prgbd.loop.sigma_learning import describe_sigma
from prgbd.loop.summary import write_summary, write_truth


class SelfImprovingLoop:
    """Alternates pose refinement (RGB-D SLAM on pseudo depth) and depth refinement until nothing improves.

    Loop 0 is the paper's pRGBD-Initial; the last one is pRGBD-Refined. Every step is remembered by the store, so a
    loop that is made again on the same store goes on where it stopped.

    Args:
        parts: What the loop works with; the network ends with the best weights.
    """

    def __init__(self, parts: LoopParts) -> None:
        self.parts = parts
        self.estimator, self.settings = parts.estimator, parts.settings
        self.store, self.monitor = parts.store, parts.monitor
        self._criterion: Criterion = make_criterion(self.settings.criterion, **self.settings.criterion_options)
        self._evidence: dict[int, dict[str, Evidence]] = {}
        self._sequences = parts.all_sequences
        self.failures = Failures(len(self._sequences), parts.monitor)

    def run(self) -> dict[str, Any]:
        """Run until there is no improvement.

        Returns:
            The summary, as in ``summary.json``.

        Raises:
            PrgbdError: If something the user can mend is wrong; the finished steps are kept.
        """
        self._check_trainable()
        self._check_weights()
        self._first_weights = {name: value.clone() for name, value in self.estimator.state_dict().items()}
        more = self._more()
        if self.settings.max_loops:
            self.monitor.say(announcement(self.settings, self.parts.refinement))
        self.store.step("truth", lambda: write_truth(self.store, self._sequences))
        loops: list[dict[str, Any]] = []
        stop: dict[str, Any] = {"reason": None, "best_loop": 0}
        if self.settings.max_loops:
            stop["reason"] = f"All refinements that task.max_loops={self.settings.max_loops} allows were made."
        for loop in range(self.settings.max_loops + 1):
            self.monitor.say(f"Loop {loop}: {loop_name(loop)}")
            refinement = PoseRefinement(self.parts, loop, self.failures)
            loops.append(refinement.run())
            self.parts = refinement.parts
            reason = self._judge(loops, stop)
            self._write(loops, more=more)
            if not reason and loop < self.settings.max_loops:
                loops[-1]["training"], reason = self._refine(loop, more)
            if reason:
                stop["reason"] = reason
                break
        if stop["reason"]:
            self.monitor.say(f"Stop: {stop['reason']}")
        self._keep_best(stop["best_loop"])
        seconds = sum(entry["seconds"] + (entry["training"] or {}).get("seconds", 0.0) for entry in loops)
        return self._write(loops, stop=stop, seconds=seconds, more=more)

    def _write(self, loops: list[dict[str, Any]], **entries: Any) -> dict[str, Any]:
        return write_summary(
            self.store, self.parts.identity, self._sequences, loops, errors=self.failures.reasons, **entries
        )

    def _more(self) -> dict[str, Any]:
        """Run the baselines; return them and the further entries of the summary."""
        tested = self.parts.test_sequences or self.parts.sequences
        test_sequences = [sequence.name for sequence in self.parts.test_sequences]
        rows = [
            run_baseline(
                kind,
                make,
                tested,
                self.settings,
                self.store,
                self.monitor,
                self.failures,
            )
            for kind, make in self.parts.baselines.items()
        ]
        self.parts = self.parts.without(self.failures)
        return {
            "test_sequences": test_sequences,
            **(
                {"depth_tests": [sequence.name for sequence in self.parts.depth_tests]}
                if self.parts.depth_tests
                else {}
            ),
            **({"baselines": rows} if rows else {}),
        }

    def _judge(self, loops: list[dict[str, Any]], stop: dict[str, Any]) -> str:
        """Let the criterion compare the last loop with the best one; return why to stop, "" to go on."""
        entry, best = loops[-1], loops[stop["best_loop"]]
        settings, loop = self.settings, entry["loop"]
        now = self._evidence[loop] = entry.pop("evidence")
        if loop == 0:
            return ""
        before = {name: found for name, found in self._evidence[best["loop"]].items() if name in now}
        verdict = self._criterion.judge(before, now, settings.min_improvement or 0.0)
        entry["criterion"] = {"compared_with": best["loop"], **verdict.to_dict()}
        self.monitor.say(f"  against loop {best['loop']}, without labels: {verdict.sentence()}")
        decides = verdict.decides and settings.min_improvement is not None
        if verdict.better or not decides:
            stop["best_loop"] = loop
            return ""
        entry["rolled_back"] = True
        text = (
            f"Loop {loop} is rolled back, for it is no better than loop {best['loop']} ({verdict.sentence()}); "
            f"network and trajectory of loop {best['loop']} are kept."
        )
        if loop - best["loop"] > settings.patience or loop == settings.max_loops:
            return text
        self.monitor.say(f"  {text} Going on for task.patience={settings.patience}.")
        return ""

    def _check_trainable(self) -> None:
        """Refuse to refine what has no weights, or no uncertainty where that alone is to be learnt."""
        if self.settings.max_loops and self._learns_uncertainty:
            if self.estimator.sigma_head() is None:
                raise ConfigError(
                    f"depth={self.parts.identity.depth} predicts no uncertainty that training.learn=uncertainty could "
                    "teach it; add depth.uncertainty=true where the network has that option, or "
                    "depth.wrappers=[self_doubting]."
                )
            return
        if self.settings.max_loops and not any(weight.requires_grad for weight in self.estimator.parameters()):
            raise ConfigError(
                f"depth={self.parts.identity.depth} has no weights that a refinement could train; add task.max_loops=0."
            )

    @property
    def _learns_uncertainty(self) -> bool:
        return self.parts.refinement is not None and self.parts.refinement.learn == "uncertainty"

    def _check_weights(self) -> None:
        """Refuse to go on with a run whose first weights were other ones."""
        found = weights_fingerprint(self.estimator)
        began_with = self.store.step("weights", lambda: found)
        if began_with != found:
            raise ConfigError(
                "The run began with other weights of the depth network than depth.weights holds now; put the old ones "
                "back, or start a new run."
            )

    def _refine(self, loop: int, more: dict[str, Any]) -> tuple[dict[str, Any] | None, str]:
        """Refine the network on SLAM's output of this loop; return the figures and why to stop, "" to go on."""
        weights = self.store.loop(loop, "weights")
        lesson = prepare(self.parts, loop, self._evidence[loop])
        self._note(lesson, loop, more)
        resumed = self.store.is_done(step_name(loop, "refine"))
        training = self.store.step(step_name(loop, "refine"), lambda: refine_in_run(self.parts, lesson, loop))
        if training is None:
            return None, "No keyframe of SLAM had neighbours on both sides, so there was nothing to learn from."
        before, after = training.get("held_out_before"), training.get("held_out_after")
        # What says how wrong depth is changes no loss.
        reason = (
            ""
            if self._learns_uncertainty
            else stop_reason(self._criterion, before, after, self.settings.min_improvement)
        )
        if before is not None and after is not None:
            self.monitor.say(f"  refined on {training['samples']} keyframes: held-out loss {before:.5f} -> {after:.5f}")
        if training.get("sigma_points"):
            self.monitor.say(describe_sigma(training))
        if not reason and resumed:
            self.estimator.load_weights(weights)
        return training, reason

    def _note(self, lesson: Lesson, loop: int, more: dict[str, Any]) -> None:
        """Tell what was chosen, and put it into the summary, with the row of SLAM on the images alone if that ran."""
        for sentence in sentences(lesson.choices):
            self.monitor.say(f"  {sentence}")
        if lesson.choices:
            more.setdefault("recipe", []).append(plain(loop, lesson.choices))
        if lesson.baseline is not None:
            rows = more.setdefault("baselines", [])
            same = next((row for row in rows if row["folder"] == lesson.baseline["folder"]), None)
            if same is None:
                rows.append(lesson.baseline)
            else:
                same["pose"] = {**same["pose"], **lesson.baseline["pose"]}

    def _keep_best(self, loop: int) -> None:
        """Go back to the network that SLAM ran with in the best loop, and keep it."""
        if loop == 0:
            self.estimator.load_state_dict(self._first_weights)
        else:
            self.estimator.load_weights(self.store.loop(loop - 1, "weights"))

        def work() -> None:
            with self.store.new_folder(self.store.path("weights")) as folder:
                self.estimator.save_weights(folder)

        self.store.step("best_weights", work)


def stop_reason(criterion: Criterion, before: float | None, after: float | None, min_improvement: float | None) -> str:
    """Return why the loop should stop after a refinement, "" to go on; no label is needed to decide.

    Args:
        criterion: What decides.
        before: Loss on held-out keyframes with the weights that SLAM ran with.
        after: The same with the refined weights.
        min_improvement: Fraction that counts as an improvement; None accepts any finite loss.
    """
    if before is None or after is None or not math.isfinite(before) or not math.isfinite(after):
        return "The held-out loss was not finite after the refinement, so the weights from before are kept."
    return "" if min_improvement is None else criterion.objection(before, after, min_improvement)
