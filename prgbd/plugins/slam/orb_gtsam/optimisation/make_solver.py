"""Solvers of bundle adjustment by name."""

from __future__ import annotations

from prgbd.core.errors import ConfigError
from prgbd.plugins.slam.orb_gtsam.optimisation.gtsam_solver import GtsamSolver
from prgbd.plugins.slam.orb_gtsam.optimisation.numba_solver import NumbaSolver
from prgbd.plugins.slam.orb_gtsam.optimisation.solver import BundleSolver

SOLVERS: dict[str, type[BundleSolver]] = {"gtsam": GtsamSolver, "numba": NumbaSolver}


def make_solver(name: str) -> BundleSolver:
    """Return the solver of that name, for local and global bundle adjustment.

    Raises:
        ConfigError: If there is none.
    """
    if name not in SOLVERS:
        raise ConfigError(f"Unknown bundle adjustment solver '{name}'; choose {' or '.join(SOLVERS)}.")
    return SOLVERS[name]()
