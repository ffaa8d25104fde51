"""``LoopParts``: what the self-improving loop works with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.slam import GeometricSLAM
from prgbd.core.types import SlamResult
from prgbd.io.export import load_result
from prgbd.loop.loop_settings import LoopSettings
from prgbd.loop.monitor import Monitor, SilentMonitor
from prgbd.loop.outcome import Failures, Look
from prgbd.loop.store import RunStore
from prgbd.loop.summary import RunIdentity
from prgbd.loop.viewing import ViewerMaker
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.trainers import TrainerFactory


@dataclass(frozen=True, kw_only=True)
class LoopParts:
    """What the self-improving loop works with.

    Attributes:
        estimator: The network, with its weights.
        make_slam: Makes a SLAM system that supports mode ``rgbd``.
        sequences: Recordings to learn from, each with its own camera.
        settings: Options of the loop.
        store: Remembers the run.
        identity: What the run is about, for the summary.
        refinement: Options of the refinement; None where there is none (``max_loops`` 0).
        trainer: The Lightning configuration that the network predicts and is refined with; by default on the CPU.
        test_sequences: Recordings that are sensed and evaluated in every loop but not learnt from.
        depth_tests: Images whose depth is evaluated in every loop, in place of that of the recordings; no SLAM runs on
            them, so they need not be neighbours in time.
        baselines: Makes the systems that the loop is compared with, by their names (see ``baselines``); they run on the
            test recordings, or on all if there are none, and one that teaches the network on all.
        monitor: Who watches.
        make_viewer: Makes a viewer for each SLAM run.
        look: Looks for what is wrong with a recording in which nothing was tracked.
    """

    estimator: DepthEstimator
    make_slam: Callable[[], GeometricSLAM]
    sequences: list[Sequence]
    settings: LoopSettings
    store: RunStore
    identity: RunIdentity
    refinement: RefinementSettings | None = None
    trainer: TrainerFactory = field(default_factory=TrainerFactory)
    test_sequences: list[Sequence] = field(default_factory=list)
    depth_tests: list[Sequence] = field(default_factory=list)
    baselines: Mapping[str, Callable[[], GeometricSLAM]] = field(default_factory=dict)
    monitor: Monitor = field(default_factory=SilentMonitor)
    make_viewer: ViewerMaker | None = None
    look: Look | None = None

    @property
    def all_sequences(self) -> list[Sequence]:
        """Recordings to learn from and test recordings."""
        return [*self.sequences, *self.test_sequences]

    def without(self, failures: Failures) -> LoopParts:
        """Return the parts without the recordings that failed."""
        return replace(
            self,
            sequences=failures.spare(self.sequences),
            test_sequences=failures.spare(self.test_sequences),
        )

    def result(self, loop: int, sequence: Sequence) -> SlamResult:
        """Read what SLAM made of a recording in a loop."""
        return load_result(self.store.loop(loop, "slam", sequence.name, "result.npz"))
