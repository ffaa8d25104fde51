"""``PoseRefinement``: SLAM on the network's depth for every recording of a loop, and what came of it in figures."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from prgbd.core.criterion import Evidence
from prgbd.core.data import Sequence
from prgbd.io.export import save_result
from prgbd.loop.depth_figures import depth_figures, write_samples
from prgbd.loop.evidence import evidence
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.outcome import Failures
from prgbd.loop.sensing import DepthSensor
from prgbd.loop.slam_runs import SlamInput, describe_pose, pose_figures, run_slam
from prgbd.loop.uncertainty_figures import describe_uncertainty, uncertainty_figures
from prgbd.training.supervision import measured_gap

# Networks that know their scene err by 10 to 20 % against triangulated depth, those that do not by 40 to 50 %.
_STRANGE = 0.3


class PoseRefinement:
    """Predicts the depth of all recordings, runs SLAM on it, and evaluates both; the store remembers every step.

    Args:
        parts: What the loop works with.
        loop: Its number.
        failures: Keeps the errors of single recordings over all loops.
    """

    def __init__(self, parts: LoopParts, loop: int, failures: Failures | None = None) -> None:
        self.parts, self.loop = parts, loop
        self.failures = failures or Failures(len(parts.all_sequences), parts.monitor)
        self.settings, self.store, self.monitor = parts.settings, parts.store, parts.monitor

    def run(self) -> dict[str, Any]:
        """Do what is not done yet; return the entry of the loop in the summary, and its ``evidence`` by recording."""
        began = time.perf_counter()
        sensors = [self._sensor(sequence) for sequence in self.parts.all_sequences]
        pose: dict[str, Any] = {}
        sensed: dict[str, Any] = {}
        found: dict[str, Any] = {}
        for sensor in sensors:
            name = sensor.sequence.name
            with self.failures.of(name):
                sense = self.store.step(self._step("sense", name), partial(self._sense, sensor))
                localised = self.store.step(self._step("slam", name), partial(self._localise, sensor))
                self.monitor.say("  " + describe_pose(name, localised))
                if self.loop == 0:
                    self._warn_of_a_strange_scene(name, localised)
                if self.settings.max_loops:
                    found[name] = self.store.step(self._step("evidence", name), partial(self._find, sensor))
                sensed[name], pose[name] = sense, localised
        self.parts = self.parts.without(self.failures)
        if not self.parts.sequences:
            raise next(iter(self.failures.errors.values()))
        sensors = [sensor for sensor in sensors if sensor.sequence.name in pose]
        self._note_recordings(list(pose))
        tests = [self._sensor(sequence) for sequence in self.parts.depth_tests]
        depth = self.store.step(self._step("depth"), lambda: self._evaluate_depth(sensors, tests))
        if depth and depth["images"]:
            self.monitor.say(describe_depth(depth))
        uncertainty = self.store.step(self._step("uncertainty"), lambda: self._judge_uncertainty(sensors, tests))
        if uncertainty:
            self.monitor.say(describe_uncertainty(uncertainty))
        seconds = self.store.step(self._step("seconds"), lambda: time.perf_counter() - began)
        if self.settings.sensing.cache is None:
            for sensor in (*sensors, *tests):
                sensor.forget()
        return {
            "loop": self.loop,
            "name": loop_name(self.loop),
            "pose": pose,
            "depth": depth,
            "uncertainty": uncertainty,
            "training": None,
            "baseline": {name: figures["baseline"] for name, figures in sensed.items()},
            "depth_max": {name: figures["depth_max"] for name, figures in sensed.items()},
            "seconds": seconds,
            "evidence": {sequence.name: found[sequence.name] for sequence in self.parts.sequences if found},
        }

    def _note_recordings(self, names: list[str]) -> None:
        """Forget what was made of fewer recordings: one that failed before may be there in a run that goes on."""
        step = self._step("recordings")
        if self.store.is_done(step) and self.store.result(step) != names:
            self.store.forget(
                *(self._step(name) for name in ("depth", "uncertainty", "refine", "seconds")), "best_weights"
            )
            self.store.forget_below(*(step_name(loop) for loop in range(self.loop + 1, self.settings.max_loops + 1)))
        self.store.finish(step, names)

    def _warn_of_a_strange_scene(self, name: str, pose: Mapping[str, Any]) -> None:
        """Say that a network whose depth SLAM's triangulation refutes had better learn from the images alone."""
        wrong = pose["depth_sigma"] or 0.0
        if wrong > _STRANGE and self.settings.max_loops and self.settings.first_teacher == "pseudo_rgbd":
            self.monitor.say(
                f"  The network's depth of {name} is wrong by {wrong:.0%}: it does not know this scene. Let SLAM on "
                "the images alone teach it first: task.first_teacher=mono, or auto, the default."
            )

    def _find(self, sensor: DepthSensor) -> Evidence:
        gap = 1 if self.parts.refinement is None else self.parts.refinement.frame_gap
        # All loops must be judged on the same pairs of frames.
        gap = gap or measured_gap(self.parts.result(0, sensor.sequence))
        return evidence(self.parts.result(self.loop, sensor.sequence), sensor, gap)

    def _sensor(self, sequence: Sequence) -> DepthSensor:
        return DepthSensor(
            self.parts.estimator,
            sequence,
            self.settings.sensing.cache or self.store.path("cache"),
            name=self.parts.identity.depth,
            percentile=self.settings.sensing.baseline_percentile,
            batch_size=self.settings.sensing.frames_at_once,
            monitor=self.monitor,
            computing=self.settings.sensing,
            fabric=self.parts.trainer.fabric,
        )

    def _sense(self, sensor: DepthSensor) -> dict[str, Any]:
        statistics = sensor.prepare()
        baseline = self.settings.baseline or statistics.adaptive_baseline
        return {"baseline": baseline, **statistics.diagnostics()}

    def _localise(self, sensor: DepthSensor) -> dict[str, Any]:
        sequence = sensor.sequence
        statistics = sensor.prepare()
        known = self.settings.baseline or statistics.adaptive_baseline
        baseline = None if self.settings.running_baseline else known
        given = SlamInput(sensor, "pseudo_rgbd", baseline, statistics, self.parts.estimator.depth_kind)
        recording = self.store.path("viz", f"{self.loop:02d}-{sequence.name}")
        viewer = None if self.parts.make_viewer is None else self.parts.make_viewer(sequence, recording)
        result = run_slam(
            self.parts.make_slam,
            sequence,
            given,
            seed=self.settings.seed,
            monitor=self.monitor,
            viewer=viewer,
            load_map=self.settings.maps.load,
            save_map=self.settings.maps.target(self.store.folder, sequence.name),
        )
        with self.store.new_folder(self.store.loop(self.loop, "slam", sequence.name)) as folder:
            save_result(result, folder, self.settings.export, frame=sequence.frame)
        return pose_figures(result, sequence, self.settings.evaluation.alignment, self.parts.look)

    def _evaluate_depth(self, sensors: list[DepthSensor], tests: list[DepthSensor]) -> dict[str, Any] | None:
        """Depth figures on the depth tests, else the test recordings, else on all; and pictures of the first or all."""
        for test in tests:
            test.prepare()
        write_samples(tests or sensors, self.store.loop(self.loop, "depth", "samples.npz"))
        return depth_figures(self._tested(sensors, tests), self.settings.evaluation)

    def _judge_uncertainty(self, sensors: list[DepthSensor], tests: list[DepthSensor]) -> dict[str, Any] | None:
        """What the network says of its error, on the same images, and at SLAM's points of all recordings."""
        results = ((sensor, self.parts.result(self.loop, sensor.sequence)) for sensor in sensors)
        return uncertainty_figures(self._tested(sensors, tests), self.settings.evaluation, results)

    def _tested(self, sensors: list[DepthSensor], tests: list[DepthSensor]) -> list[DepthSensor]:
        return tests or sensors[len(self.parts.sequences) :] or sensors

    def _step(self, *parts: str) -> str:
        return step_name(self.loop, *parts)


def loop_name(loop: int) -> str:
    """Return the paper's name of a loop."""
    return "pRGBD-Initial" if loop == 0 else f"pRGBD-Refined ({loop})" if loop > 1 else "pRGBD-Refined"


def describe_depth(figures: Mapping[str, Any]) -> str:
    """Return one line about depth figures."""
    return f"  depth: Abs Rel {figures['abs_rel']:.4f}, a1 {figures['a1']:.3f} ({figures['images']} images)"


def step_name(loop: int, *parts: str) -> str:
    """Return the name of a step of a loop in the store."""
    return "/".join(("loops", f"{loop:02d}", *parts))
