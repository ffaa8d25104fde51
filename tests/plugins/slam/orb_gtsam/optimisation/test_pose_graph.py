from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.errors import ContractError
from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, inverse
from prgbd.plugins.slam.orb_gtsam.optimisation.pose_graph import PoseGraphEdges, optimise_pose_graph

SIGMA = 0.002


class Ring:
    """A drive around a circle of 20 m with odometry edges, true loop edges and false ones."""

    def __init__(self, count=120, noise=SIGMA, shrink=1.0, loops=4, false=0, seed=0):
        rng = np.random.default_rng(seed)
        angles = np.linspace(0, 2 * np.pi, count)
        self.wTc = np.stack([exp_se3(np.array([0, a, 0, 0, 0, 0])) for a in angles])
        self.wTc[:, 0, 3], self.wTc[:, 2, 3] = 20 * np.sin(angles), 20 * np.cos(angles)
        self.i = np.r_[np.arange(count - 1), np.arange(loops), rng.integers(0, count // 2, false)]
        self.j = np.r_[np.arange(1, count), count - loops + np.arange(loops), rng.integers(count // 2, count, false)]
        self.iTj = inverse(self.wTc[self.i]) @ self.wTc[self.j]
        wrong = np.arange(len(self.i)) >= count - 1 + loops
        for e in np.flatnonzero(wrong):
            self.iTj[e] = exp_se3(rng.normal(0, [0.3] * 3 + [3] * 3))
        self.iTj = np.stack([T @ exp_se3(noise * rng.standard_normal(6)) for T in self.iTj])
        # Each frame's own scale, as monocular SLAM drifts: what camera k measures comes out divided by it.
        self.scale = shrink ** np.arange(count)
        self.iTj[:, :3, 3] /= self.scale[self.i, None]
        self.ratio = self.scale[self.j] / self.scale[self.i]
        self.ratio[wrong] = 1.0
        self.loop = np.arange(len(self.i)) >= count - 1
        self.sigmas = np.full(len(self.i), SIGMA)
        guess = [self.wTc[0]]
        for k in range(count - 1):
            guess.append(guess[-1] @ self.iTj[k])
        self.guess = np.stack(guess)

    @property
    def edges(self) -> PoseGraphEdges:
        return PoseGraphEdges(self.i, self.j, self.iTj, self.sigmas)

    def solve(self, *, scales=None, robust=None, **options):
        return optimise_pose_graph(self.guess, replace(self.edges, scales=scales, robust=robust), **options)

    def error(self, wTc):
        return float(np.linalg.norm(wTc[:, :3, 3] - self.wTc[:, :3, 3], axis=1).max())


def test_exact_edges_give_the_truth():
    ring = Ring(noise=0.0)
    rng = np.random.default_rng(0)
    ring.guess = np.stack([T @ exp_se3(0.05 * rng.standard_normal(6)) for T in ring.guess])
    ring.guess[0] = ring.wTc[0]
    wTc, scale = ring.solve()
    np.testing.assert_allclose(wTc, ring.wTc, atol=1e-5)
    np.testing.assert_array_equal(scale, 1.0)


def test_loops_reduce_the_drift():
    ring = Ring()
    wTc, _ = ring.solve()
    assert ring.error(wTc) < 0.5 * ring.error(ring.guess)
    np.testing.assert_array_equal(wTc[0], ring.guess[0])


def test_the_solution_is_a_minimum():
    ring = Ring(count=30)
    wTc, _ = ring.solve(iterations=100)

    def cost(poses):
        error = inverse(ring.iTj) @ inverse(poses[ring.i]) @ poses[ring.j]
        skew = error[:, [2, 0, 1], [1, 2, 0]] - error[:, [1, 2, 0], [2, 0, 1]]
        return np.sum(skew**2) / 4 + np.sum(error[:, :3, 3] ** 2)

    best = cost(wTc)
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = wTc.copy()
        k = int(rng.integers(1, 30))
        other[k] = other[k] @ exp_se3(1e-3 * rng.standard_normal(6))
        assert cost(other) > best


@pytest.mark.parametrize("fixed", [0, 57])
def test_any_pose_can_be_the_fixed_one(fixed):
    ring = Ring(noise=0.0)
    ring.guess = exp_se3(np.array([0.1, 0.2, 0.3, 1, 2, 3.0])) @ ring.guess
    wTc, _ = ring.solve(fixed=fixed)
    np.testing.assert_array_equal(wTc[fixed], ring.guess[fixed])
    np.testing.assert_allclose(inverse(wTc[:1]) @ wTc, inverse(ring.wTc[:1]) @ ring.wTc, atol=1e-5)


@pytest.mark.parametrize("similar", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_false_loops_are_dropped_and_true_ones_kept(seed, similar):
    ring, clean = Ring(false=2, seed=seed), Ring(seed=seed)
    clean.guess, clean.iTj = ring.guess, ring.iTj[: len(clean.i)]
    scales = {"scales": ring.ratio} if similar else {}
    wTc, _ = ring.solve(robust=ring.loop, **scales)
    plain, _ = ring.solve(**scales)
    expected, _ = clean.solve(**({"scales": clean.ratio} if similar else {}))
    assert ring.error(plain) > 5.0
    np.testing.assert_allclose(wTc, expected, atol=1e-3)


def test_sim3_undoes_the_drift_of_scale():
    ring = Ring(noise=0.0, shrink=0.995)
    assert ring.error(ring.guess) > 5.0
    rigid, _ = ring.solve()
    wTc, scale = ring.solve(scales=ring.ratio)
    assert ring.error(rigid) > 1.0
    np.testing.assert_allclose(wTc, ring.wTc, atol=1e-3)
    np.testing.assert_allclose(scale, ring.scale, rtol=1e-4)
    # The documented meaning: a point of camera j lies at scale * R p + t.
    point = np.array([0.3, -0.2, 2.0])
    e = 40
    i, j = ring.i[e], ring.j[e]
    in_i = ring.ratio[e] * ring.iTj[e, :3, :3] @ point + ring.iTj[e, :3, 3]
    by_i = scale[i] * wTc[i, :3, :3] @ in_i + wTc[i, :3, 3]
    by_j = scale[j] * wTc[j, :3, :3] @ point + wTc[j, :3, 3]
    np.testing.assert_allclose(by_i, by_j, atol=1e-3)


def test_sigmas_may_be_columns_or_information_matrices():
    ring = Ring()
    expected, _ = ring.solve()
    columns = np.tile(SIGMA, (len(ring.i), 6))
    for spread in (columns, np.tile(np.eye(6) / SIGMA**2, (len(ring.i), 1, 1))):
        wTc, _ = optimise_pose_graph(ring.guess, replace(ring.edges, sigmas=spread))
        np.testing.assert_allclose(wTc, expected, atol=1e-4)
    columns[:, 3:] *= 100
    other, _ = optimise_pose_graph(ring.guess, replace(ring.edges, sigmas=columns))
    assert np.abs(other - expected).max() > 1e-3


def test_a_part_without_connection_keeps_its_place():
    ring = Ring(noise=0.0, loops=0)
    apart = (ring.i != 59) | (ring.j != 60)
    moved = ring.guess.copy()
    moved[60:] = exp_se3(np.array([0, 0, 0, 5.0, 0, 0])) @ moved[60:]
    wTc, _ = optimise_pose_graph(
        moved, PoseGraphEdges(ring.i[apart], ring.j[apart], ring.iTj[apart], ring.sigmas[apart])
    )
    np.testing.assert_allclose(wTc, moved, atol=1e-6)


def test_nothing_to_do_and_bad_input():
    ring = Ring()
    none = np.zeros(0, np.int64)
    wTc, scale = optimise_pose_graph(ring.guess, PoseGraphEdges(none, none, np.zeros((0, 4, 4)), np.zeros(0)))
    np.testing.assert_array_equal(wTc, ring.guess)
    assert scale.shape == (len(wTc),)
    with pytest.raises(ContractError, match="lengths"):
        replace(ring.edges, j=ring.j[1:])
    with pytest.raises(ContractError, match="do not exist"):
        optimise_pose_graph(ring.guess[:-1], ring.edges)
    with pytest.raises(ContractError, match="hold pose"):
        ring.solve(fixed=500)
    with pytest.raises(ContractError, match="positive"):
        ring.solve(scales=-ring.ratio)
    ring.iTj[0, 0, 0] = np.nan
    with pytest.raises(ContractError, match="finite"):
        ring.solve()
