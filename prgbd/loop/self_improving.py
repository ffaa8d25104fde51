"""``SelfImprovingLoop``: SLAM on the network's depth, the network refined on SLAM's output, and again."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import ConfigError
from prgbd.core.slam import GeometricSLAM
from prgbd.core.types import SlamResult
from prgbd.io.export import load_result, save_result
from prgbd.loop.baselines import baseline_result, localise
from prgbd.loop.criterion import compare, stop_reason
from prgbd.loop.depth_figures import depth_figures, write_samples
from prgbd.loop.evidence import evidence
from prgbd.loop.loop_settings import LoopSettings
from prgbd.loop.monitor import Monitor, SilentMonitor
from prgbd.loop.refining import refine_in_run
from prgbd.loop.sensing import DepthSensor, weights_fingerprint
from prgbd.loop.slam_runs import SlamInput, describe_pose, pose_figures, run_slam
from prgbd.loop.store import RunStore
from prgbd.loop.summary import RunIdentity, write_summary, write_truth
from prgbd.loop.viewing import ViewerMaker
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.supervision import measured_gap
from prgbd.training.trainers import TrainerFactory

# Networks that know their scene err by 10 to 20 % against triangulated depth, those that do not by 40 to 50 %.
_STRANGE = 0.3


class SelfImprovingLoop:
    """Alternates pose refinement (RGB-D SLAM on pseudo depth) and depth refinement until nothing improves.

    Loop 0 is the paper's pRGBD-Initial; the last one is pRGBD-Refined. Every step is remembered by the store, so a
    loop that is made again on the same store goes on where it stopped.

    Args:
        estimator: The network, with its weights; it ends with the best ones.
        make_slam: Makes a SLAM system that supports mode ``rgbd``.
        sequences: Recordings to learn from, each with its own camera.
        refinement: Options of the refinement; None where there is none (``max_loops`` 0).
        settings: Options of the loop.
        store: Remembers the run.
        identity: What the run is about, for the summary.
        trainer: The Lightning configuration that the network predicts and is refined with; by default on the CPU.
        test_sequences: Recordings that are sensed and evaluated in every loop but not learnt from.
        depth_tests: Images whose depth is evaluated in every loop, in place of that of the recordings; no SLAM runs on
            them, so they need not be neighbours in time.
        monitor: Who watches.
        make_viewer: Makes a viewer for each SLAM run.
        more: Further entries of the summary.
    """

    def __init__(
        self,
        estimator: DepthEstimator,
        make_slam: Callable[[], GeometricSLAM],
        sequences: list[Sequence],
        refinement: RefinementSettings | None,
        settings: LoopSettings,
        store: RunStore,
        identity: RunIdentity,
        *,
        trainer: TrainerFactory | None = None,
        test_sequences: list[Sequence] | None = None,
        depth_tests: list[Sequence] | None = None,
        monitor: Monitor | None = None,
        make_viewer: ViewerMaker | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        self.estimator = estimator
        self.make_slam = make_slam
        self.sequences = sequences
        self.test_sequences = test_sequences or []
        self.depth_tests = depth_tests or []
        self.refinement = refinement
        self.trainer = trainer or TrainerFactory()
        self.settings = settings
        self.store = store
        self.identity = identity
        self.monitor = monitor or SilentMonitor()
        self.make_viewer = make_viewer
        self._evidence: dict[int, dict[str, Any]] = {}
        self.more = {
            "test_sequences": [sequence.name for sequence in self.test_sequences],
            **({"depth_tests": [sequence.name for sequence in self.depth_tests]} if self.depth_tests else {}),
            **(more or {}),
        }

    @property
    def all_sequences(self) -> list[Sequence]:
        """Recordings to learn from and test recordings."""
        return [*self.sequences, *self.test_sequences]

    def run(self) -> dict[str, Any]:
        """Run until there is no improvement.

        Returns:
            The summary, as in ``summary.json``.

        Raises:
            PrgbdError: If something the user can mend is wrong; the finished steps are kept.
        """
        self._check_weights()
        self._first_weights = {name: value.clone() for name, value in self.estimator.state_dict().items()}
        self.store.step("truth", lambda: write_truth(self.store, self.all_sequences))
        loops: list[dict[str, Any]] = []
        stop: dict[str, Any] = {"reason": None, "best_loop": 0}
        if self.settings.max_loops:
            stop["reason"] = f"All refinements that task.max_loops={self.settings.max_loops} allows were made."
        for loop in range(self.settings.max_loops + 1):
            self.monitor.say(f"Loop {loop}: {loop_name(loop)}")
            loops.append(self._sense_and_localise(loop))
            reason = self._judge(loops, stop)
            write_summary(self.store, self.identity, self.all_sequences, loops, more=self.more)
            if not reason and loop < self.settings.max_loops:
                loops[-1]["training"], reason = self._refine(loop)
            if reason:
                stop["reason"] = reason
                break
        if stop["reason"]:
            self.monitor.say(f"Stop: {stop['reason']}")
        self._keep_best(stop["best_loop"])
        seconds = sum(entry["seconds"] + (entry["training"] or {}).get("seconds", 0.0) for entry in loops)
        return write_summary(
            self.store, self.identity, self.all_sequences, loops, stop=stop, seconds=seconds, more=self.more
        )

    def _judge(self, loops: list[dict[str, Any]], stop: dict[str, Any]) -> str:
        """Compare the last loop with the best one by SLAM's evidence; return why to stop, "" to go on."""
        entry, best = loops[-1], loops[stop["best_loop"]]
        settings, loop = self.settings, entry["loop"]
        evidences = entry.pop("evidence"), self._evidence.get(best["loop"])
        self._evidence[loop] = evidences[0]
        if loop == 0:
            return ""
        assert evidences[1] is not None
        verdict = compare(evidences[1], evidences[0], settings.min_improvement or 0.0)
        entry["criterion"] = {"compared_with": best["loop"], **verdict.to_dict()}
        self.monitor.say(f"  against loop {best['loop']}, without labels: {verdict.sentence()}")
        decides = settings.criterion in ("slam", "both") and settings.min_improvement is not None
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

    def _check_weights(self) -> None:
        """Refuse to go on with a run whose first weights were other ones."""
        found = weights_fingerprint(self.estimator)
        began_with = self.store.step("weights", lambda: found)
        if began_with != found:
            raise ConfigError(
                "The run began with other weights of the depth network than depth.weights holds now; put the old ones "
                "back, or start a new run."
            )

    def _sense_and_localise(self, loop: int) -> dict[str, Any]:
        """Depth and SLAM of every sequence, and both evaluated: one entry of the summary's ``loops``."""
        began = time.perf_counter()
        sensors = [self._sensor(loop, sequence) for sequence in self.all_sequences]
        pose: dict[str, Any] = {}
        sensed: dict[str, Any] = {}
        found: dict[str, Any] = {}
        for sensor in sensors:
            name = sensor.sequence.name
            sensed[name] = self.store.step(step_name(loop, "sense", name), partial(self._sense, sensor))
            pose[name] = self.store.step(step_name(loop, "slam", name), partial(self._localise, loop, sensor))
            self.monitor.say("  " + describe_pose(name, pose[name]))
            if loop == 0:
                self._warn_of_a_strange_scene(name, pose[name])
            if self.settings.max_loops:
                found[name] = self.store.step(step_name(loop, "evidence", name), partial(self._find, loop, sensor))
        tests = [self._sensor(loop, sequence) for sequence in self.depth_tests]
        depth = self.store.step(step_name(loop, "depth"), lambda: self._evaluate_depth(loop, sensors, tests))
        if depth and depth["images"]:
            self.monitor.say(describe_depth(depth))
        seconds = self.store.step(step_name(loop, "seconds"), lambda: time.perf_counter() - began)
        if self.settings.cache is None:
            for sensor in (*sensors, *tests):
                sensor.forget()
        return {
            "loop": loop,
            "name": loop_name(loop),
            "pose": pose,
            "depth": depth,
            "training": None,
            "baseline": {name: figures["baseline"] for name, figures in sensed.items()},
            "depth_max": {name: figures["depth_max"] for name, figures in sensed.items()},
            "seconds": seconds,
            "evidence": {sequence.name: found[sequence.name] for sequence in self.sequences if found},
        }

    def _warn_of_a_strange_scene(self, name: str, pose: Mapping[str, Any]) -> None:
        """Say that a network whose depth SLAM's triangulation refutes had better learn from the images alone."""
        wrong = pose["depth_sigma"] or 0.0
        if wrong > _STRANGE and self.settings.max_loops and self.settings.first_teacher == "pseudo_rgbd":
            self.monitor.say(
                f"  The network's depth of {name} is wrong by {wrong:.0%}: it does not know this scene. Let SLAM on "
                "the images alone teach it first: task.first_teacher=mono, or experiment=adapt."
            )

    def _find(self, loop: int, sensor: DepthSensor) -> dict[str, Any]:
        gap = 1 if self.refinement is None else self.refinement.frame_gap
        # All loops must be judged on the same pairs of frames.
        gap = gap or measured_gap(self._result(0, sensor.sequence))
        return evidence(self._result(loop, sensor.sequence), sensor, gap)

    def _sensor(self, loop: int, sequence: Sequence) -> DepthSensor:
        return DepthSensor(
            self.estimator,
            sequence,
            self.settings.cache or self.store.path("cache"),
            name=self.identity.depth,
            percentile=self.settings.baseline_percentile,
            batch_size=self.settings.batch_size,
            monitor=self.monitor,
            computing=self.settings.computing,
            fabric=self.trainer.fabric,
        )

    def _sense(self, sensor: DepthSensor) -> dict[str, Any]:
        statistics = sensor.prepare()
        baseline = self.settings.baseline or statistics.adaptive_baseline
        return {"baseline": baseline, **statistics.diagnostics()}

    def _localise(self, loop: int, sensor: DepthSensor) -> dict[str, Any]:
        sequence = sensor.sequence
        statistics = sensor.prepare()
        known = self.settings.baseline or statistics.adaptive_baseline
        baseline = None if self.settings.running_baseline else known
        given = SlamInput(sensor, "pseudo_rgbd", baseline, statistics)
        recording = self.store.path("viz", f"{loop:02d}-{sequence.name}")
        viewer = None if self.make_viewer is None else self.make_viewer(sequence, recording)
        result = run_slam(
            self.make_slam,
            sequence,
            given,
            seed=self.settings.seed,
            monitor=self.monitor,
            viewer=viewer,
            load_map=self.settings.maps.load,
            save_map=self.settings.maps.target(self.store.folder, sequence.name),
        )
        with self.store.new_folder(self.store.loop(loop, "slam", sequence.name)) as folder:
            save_result(result, folder, self.settings.export, frame=sequence.frame)
        return pose_figures(result, sequence, self.settings.alignment)

    def _evaluate_depth(self, loop: int, sensors: list[DepthSensor], tests: list[DepthSensor]) -> dict[str, Any] | None:
        """Depth figures on the depth tests, else the test recordings, else on all; and pictures of the first or all."""
        for test in tests:
            test.prepare()
        write_samples(tests or sensors, self.store.loop(loop, "depth", "samples.npz"))
        tested = tests or sensors[len(self.sequences) :] or sensors
        return depth_figures(tested, self.settings.depth)

    def _refine(self, loop: int) -> tuple[dict[str, Any] | None, str]:
        """Refine the network on SLAM's output of this loop; return the figures and why to stop, "" to go on."""
        weights = self.store.loop(loop, "weights")

        def work() -> dict[str, Any] | None:
            assert self.refinement is not None
            supervised = [(sequence, self._teacher(loop, sequence)) for sequence in self.sequences]
            return refine_in_run(
                self.estimator, supervised, self.refinement, self.trainer, self.store, loop, self.monitor
            )

        resumed = self.store.is_done(step_name(loop, "refine"))
        training = self.store.step(step_name(loop, "refine"), work)
        if training is None:
            return None, "No keyframe of SLAM had neighbours on both sides, so there was nothing to learn from."
        before, after = training["held_out_before"], training["held_out_after"]
        # Where the held-out loss does not decide, it must still be finite.
        least = None if self.settings.criterion == "slam" else self.settings.min_improvement
        reason = stop_reason(before, after, least)
        if before is not None and after is not None:
            self.monitor.say(f"  refined on {training['samples']} keyframes: held-out loss {before:.5f} -> {after:.5f}")
        if not reason and resumed:
            self.estimator.load_weights(weights)
        return training, reason

    def _teacher(self, loop: int, sequence: Sequence) -> SlamResult:
        """What the network learns from: SLAM's result of this loop, or at first that on the images alone."""
        if loop > 0 or self.settings.first_teacher == "pseudo_rgbd":
            return self._result(loop, sequence)
        pose = localise("mono", self.make_slam, sequence, self.settings, self.store, self.monitor)
        self.monitor.say("  teacher, the images alone: " + describe_pose(sequence.name, pose))
        return baseline_result("mono", sequence, self.store)

    def _result(self, loop: int, sequence: Sequence) -> SlamResult:
        return load_result(self.store.loop(loop, "slam", sequence.name, "result.npz"))

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


def loop_name(loop: int) -> str:
    """Return the paper's name of a loop."""
    return "pRGBD-Initial" if loop == 0 else f"pRGBD-Refined ({loop})" if loop > 1 else "pRGBD-Refined"


def describe_depth(figures: Mapping[str, Any]) -> str:
    """Return one line about depth figures."""
    return f"  depth: Abs Rel {figures['abs_rel']:.4f}, a1 {figures['a1']:.3f} ({figures['images']} images)"


def step_name(loop: int, *parts: str) -> str:
    """Return the name of a step of a loop in the store."""
    return "/".join(("loops", f"{loop:02d}", *parts))
