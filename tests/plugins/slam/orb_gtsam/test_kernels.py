"""What the compiled functions must keep to, so that a run gives the same numbers however its kernels were loaded."""

import importlib
import os
import pkgutil
import subprocess
import sys

import pytest
from numba.core.dispatcher import Dispatcher

from prgbd.plugins.slam import orb_gtsam

# Bundle adjustment and motion-only bundle adjustment: the kernels whose sums may be reordered.
SCRIPT = """
import numpy as np
from prgbd.plugins.slam.orb_gtsam.optimisation.make_solver import make_solver
from prgbd.plugins.slam.orb_gtsam.optimisation.pose_optimisation import optimise_pose
from tests.plugins.slam.orb_gtsam.scenes import CAMERA, drive

scene = drive(outliers=0.1)
rows = scene.kf == 3
seen = scene.xyz0[scene.pt[rows]], scene.uvr[rows], scene.inv_sigma2[rows]
pose, inlier = optimise_pose(scene.cTw0[3], *seen, CAMERA, depth_fallback=True)
adjusted = make_solver("numba").refine_locally(scene.problem)
print(pose.tobytes().hex(), inlier.tobytes().hex(), adjusted.cTw.tobytes().hex(), adjusted.xyz.tobytes().hex())
"""

# What the kernels above share, compiled on its own account before they are.
OTHERS_FIRST = """
import numpy as np
from prgbd.plugins.slam.orb_gtsam.geometry.lie import compose_into, exp_se3_into
from prgbd.plugins.slam.orb_gtsam.optimisation.reprojection import keep_monocular, penalty

penalty(1.0, True, True)
keep_monocular(np.eye(4), np.ones(3), np.ones(3), np.ones(2), np.ones(5))
exp_se3_into(np.zeros(6), np.eye(4))
compose_into(np.eye(4), np.eye(4), np.eye(4))
"""


def kernels():
    """Return every compiled function of the plug-in."""
    modules = [
        importlib.import_module(m.name) for m in pkgutil.walk_packages(orb_gtsam.__path__, f"{orb_gtsam.__name__}.")
    ]
    found = {id(v): v for module in modules for v in vars(module).values() if isinstance(v, Dispatcher)}
    return list(found.values())


def callees(kernel):
    names = kernel.py_func.__code__.co_names
    return [kernel.py_func.__globals__[n] for n in names if isinstance(kernel.py_func.__globals__.get(n), Dispatcher)]


def reorders_sums(kernel):
    return bool(kernel.targetoptions.get("fastmath")) or any(map(reorders_sums, callees(kernel)))


def test_kernels_that_reorder_sums_are_inlined_into_their_callers():
    called = {id(c): c for kernel in kernels() for c in callees(kernel)}.values()
    bare = [k.__name__ for k in called if reorders_sums(k) and not k.targetoptions.get("forceinline")]
    assert sum(map(reorders_sums, called)) > 5
    assert bare == []


def test_no_kernel_inherits_how_it_is_compiled_from_whoever_calls_it_first():
    settled = ("fastmath", "forceinline", "error_model")
    assert [k.__name__ for k in kernels() if not all(name in k.targetoptions for name in settled)] == []


@pytest.mark.slow
def test_compiling_in_any_order_and_loading_from_the_cache_give_the_same_bytes(tmp_path):
    def run(cache, script=SCRIPT):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / cache)}
        return subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        ).stdout

    compiling = run("a")
    assert list((tmp_path / "a").rglob("schur.minimise-*.nbc"))
    assert len(compiling) > 1000
    assert run("a") == compiling
    assert run("b", OTHERS_FIRST + SCRIPT) == compiling
