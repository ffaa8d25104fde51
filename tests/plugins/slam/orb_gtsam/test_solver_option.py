"""A whole sequence with each solver of bundle adjustment."""

import numpy as np

from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from tests.plugins.slam.orb_gtsam.walls import CAMERA, error, path, view

POSES = path(16)


def run(solver: str):
    with OrbGtsamSLAM(solver=solver, keyframes={"ratio": 2.0, "ratio_first": 2.0}) as system:
        system.reset(CAMERA, "rgbd", baseline=0.1, fps=10.0)
        for i, wTc in enumerate(POSES):
            system.track(view(i, wTc))
        return system.finish()


def test_gtsam_maps_a_whole_sequence_as_numba_does() -> None:
    numba, gtsam = run("numba"), run("gtsam")
    assert set(gtsam.states) == {"ok"}
    assert gtsam.stats["full_ba"]["backend"] == "gtsam"
    assert len(gtsam.keyframes) > 5
    truth = np.stack([wTc[:3, 3] for wTc in POSES])
    for result in (numba, gtsam):
        assert error(result.trajectory.positions, truth, scale=False) < 0.01
    np.testing.assert_allclose(gtsam.trajectory.wTc, numba.trajectory.wTc, atol=5e-3)


def test_with_gtsam_no_adjustment_is_left_to_numba(monkeypatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the compiled solver was asked")

    monkeypatch.setattr("prgbd.plugins.slam.orb_gtsam.optimisation.numba_solver.minimise", refuse)
    assert run("gtsam").tracked_frames == len(POSES)
