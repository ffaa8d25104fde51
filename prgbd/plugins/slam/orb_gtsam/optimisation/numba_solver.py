"""Bundle adjustment by the compiled Schur-complement solver."""

from __future__ import annotations

from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BoolArray, BundleState
from prgbd.plugins.slam.orb_gtsam.optimisation.schur import minimise
from prgbd.plugins.slam.orb_gtsam.optimisation.solver import TOLERANCE, BundleSolver


class NumbaSolver(BundleSolver):
    """Eliminates the points and factorises what is left within an envelope; free of the interpreter's lock.

    The envelope stays small for cameras in temporal order, so it is the faster one up to a few hundred keyframes.
    """

    def minimise(
        self, state: BundleState, active: BoolArray, *, robust: bool, iterations: int, tolerance: float = TOLERANCE
    ) -> None:
        """See ``BundleSolver.minimise``."""
        minimise(
            state.poses,
            state.points,
            state.column,
            state.free,
            state.kf,
            state.pt,
            state.first,
            state.uvr,
            state.weight,
            state.camera,
            active,
            robust,
            iterations,
            tolerance,
        )
