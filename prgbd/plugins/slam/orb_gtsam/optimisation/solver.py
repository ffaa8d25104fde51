"""The interface of bundle adjustment: what all solvers do alike, and the one step in which they differ."""

from __future__ import annotations

from abc import ABC, abstractmethod

from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BoolArray, BundleProblem, BundleResult, BundleState

# Relative decrease of the cost at which bundle adjustment has converged.
TOLERANCE = 1e-5


class BundleSolver(ABC):
    """Refines poses and points together; solvers agree in everything but how they minimise.

    ``refine_locally`` and ``refine_globally`` take a problem as it is given and leave it as it is. ``minimise`` is
    their one step, for whoever changes the problem between two of them.
    """

    @abstractmethod
    def minimise(
        self, state: BundleState, active: BoolArray, *, robust: bool, iterations: int, tolerance: float = TOLERANCE
    ) -> None:
        """Refine poses and points of a state in place by Levenberg-Marquardt; fixed poses stay exactly as they are.

        Whatever comes out is finite and costs no more than before.

        Args:
            state: The problem at work.
            active: (M,) bool, in the state's order, the observations that count.
            robust: Whether to apply a Huber kernel.
            iterations: Most iterations.
            tolerance: Relative decrease of the cost at which to end.
        """

    def refine_locally(
        self,
        problem: BundleProblem,
        *,
        iterations: tuple[int, int] = (5, 10),
        robust: bool = True,
        depth_fallback: bool = False,
        tolerance: float = TOLERANCE,
    ) -> BundleResult:
        """Refine keyframes and points in two rounds, as ORB-SLAM2's ``LocalBundleAdjustment``.

        First with a Huber kernel on all observations, then without it on those that pass the chi-square test and lie
        in front of their camera. With ``robust=False`` both rounds run without kernel and removal.

        Args:
            problem: Poses, points and observations.
            iterations: Most iterations of the two rounds; a round ends earlier when it has converged.
            robust: Whether to apply the kernel and the removal of outliers.
            depth_fallback: Whether observations that only their depth makes outliers go on as monocular ones in the
                second round (needs ``robust``).
            tolerance: Relative decrease of the cost at which a round has converged.

        Returns:
            Refined poses and points, all finite.
        """
        state = BundleState.of(problem)
        initial_cost = state.cost(robust)
        self.minimise(state, state.usable, robust=robust, iterations=iterations[0], tolerance=tolerance)
        if robust and depth_fallback:
            state.reject_depths()
        active = state.inliers() if robust else state.usable
        self.minimise(state, active, robust=False, iterations=iterations[1], tolerance=tolerance)
        return state.result(initial_cost, robust)

    def refine_globally(
        self, problem: BundleProblem, *, iterations: int = 10, robust: bool = True, tolerance: float = TOLERANCE
    ) -> BundleResult:
        """Refine all keyframes and points in one round, as ORB-SLAM2's ``GlobalBundleAdjustemnt``.

        Args:
            problem: Poses, points and observations.
            iterations: Most iterations.
            robust: Whether to apply a Huber kernel.
            tolerance: Relative decrease of the cost at which the adjustment has converged.

        Returns:
            Refined poses and points, all finite.
        """
        state = BundleState.of(problem)
        initial_cost = state.cost(robust)
        self.minimise(state, state.usable, robust=robust, iterations=iterations, tolerance=tolerance)
        return state.result(initial_cost, robust)
