import numpy as np
import pytest
from scipy.optimize import least_squares

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, log_so3
from prgbd.plugins.slam.orb_gtsam.geometry.two_view import initialise_two_view, triangulate_pairs

K = np.array([[500.0, 0, 320], [0, 510.0, 240], [0, 0, 1]])
SIDEWAYS = (0.0, 0.04, 0.0, 0.5, 0.05, 0.1)


def matches(kind, twist, count=400, noise=0.5, outliers=0.1, seed=0):
    """Return pixels in both views, the true motion, the true points in camera 1, and which matches are wrong."""
    rng = np.random.default_rng(seed)
    uv1 = rng.uniform([0, 0], [640, 480], (count, 2))
    rays = np.c_[(uv1 - K[:2, 2]) / K.diagonal()[:2], np.ones(count)]
    depth = rng.uniform(3, 15, count) if kind == "deep" else -4 / (rays @ [0.1, 0.2, -1.0])
    xyz = rays * depth[:, None]
    c2Tc1 = exp_se3(np.array(twist))
    in2 = xyz @ c2Tc1[:3, :3].T + c2Tc1[:3, 3]
    uv2 = in2[:, :2] / in2[:, 2:] * K.diagonal()[:2] + K[:2, 2]
    uv1, uv2 = (uv + noise * rng.standard_normal(uv.shape) for uv in (uv1, uv2))
    bad = rng.random(count) < outliers
    uv2[bad] = rng.uniform([0, 0], [640, 480], (int(bad.sum()), 2))
    return uv1, uv2, c2Tc1, xyz, bad


def check_motion(found, c2Tc1, rotation, direction):
    assert np.linalg.norm(log_so3(found[:3, :3] @ c2Tc1[:3, :3].T)) < rotation
    assert np.linalg.norm(found[:3, 3]) == pytest.approx(1.0)
    cosine = found[:3, 3] @ c2Tc1[:3, 3] / np.linalg.norm(c2Tc1[:3, 3])
    assert np.degrees(np.arccos(min(cosine, 1.0))) < direction


@pytest.mark.parametrize("twist", [SIDEWAYS, (0.02, 0.0, 0.03, 0.05, 0.0, -1.2), (0.0, -0.1, 0.0, -0.6, 0.3, 0.0)])
@pytest.mark.parametrize("seed", range(3))
def test_a_deep_scene_is_solved_by_the_essential_matrix(twist, seed):
    uv1, uv2, c2Tc1, xyz, bad = matches("deep", twist, seed=seed)
    view = initialise_two_view(uv1, uv2, K, seed)
    assert view is not None
    assert view.model == "F"
    check_motion(view.c2Tc1, c2Tc1, 0.004, 1.5)
    # A wrong match near its epipolar line cannot be told from a right one.
    assert (view.good & bad).sum() <= 3
    assert view.good[~bad].mean() > 0.85
    ratio = np.linalg.norm(view.xyz[view.good & ~bad], axis=1) / np.linalg.norm(xyz[view.good & ~bad], axis=1)
    assert np.median(ratio) == pytest.approx(1 / np.linalg.norm(c2Tc1[:3, 3]), rel=0.02)
    assert not view.xyz[~view.good].any()


@pytest.mark.parametrize("twist", [(0, 0.03, 0, 0.6, 0, 0), (0.05, 0, 0, 0, 0.4, 0)])
@pytest.mark.parametrize("seed", range(3))
def test_a_plane_is_solved_by_the_homography(twist, seed):
    uv1, uv2, c2Tc1, _, bad = matches("plane", twist, seed=seed)
    view = initialise_two_view(uv1, uv2, K, seed)
    assert view is not None
    assert view.model == "H"
    check_motion(view.c2Tc1, c2Tc1, 0.006, 2.0)
    assert not (view.good & bad).any()
    assert view.good[~bad].mean() > 0.95


@pytest.mark.parametrize("kind", ["deep", "plane"])
def test_exact_matches_give_the_truth(kind):
    uv1, uv2, c2Tc1, xyz, _ = matches(kind, (0, 0.03, 0, 0.6, 0.02, 0), noise=0.0, outliers=0.0)
    view = initialise_two_view(uv1, uv2, K)
    assert view is not None
    check_motion(view.c2Tc1, c2Tc1, 1e-4, 0.05)
    assert view.good.mean() > 0.98
    scaled = view.xyz[view.good] * np.linalg.norm(c2Tc1[:3, 3])
    np.testing.assert_allclose(scaled, xyz[view.good], rtol=2e-3, atol=1e-2)
    centre = -c2Tc1[:3, :3].T @ c2Tc1[:3, 3]
    a, b = xyz, xyz - centre
    angle = np.arccos(np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1))
    assert view.parallax == pytest.approx(np.sort(angle)[-50], rel=0.02)


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("kind", ["deep", "plane"])
@pytest.mark.parametrize("seed", range(3))
def test_a_pure_rotation_is_refused(kind, noise, seed):
    uv1, uv2, *_ = matches(kind, (0.02, 0.1, 0.02, 0, 0, 0), noise=noise, seed=seed)
    assert initialise_two_view(uv1, uv2, K, seed) is None


def test_too_little_parallax_is_refused():
    uv1, uv2, *_ = matches("deep", (0, 0.01, 0, 0.02, 0, 0))
    assert initialise_two_view(uv1, uv2, K) is None


def test_an_ambiguous_plane_is_refused():
    # Towards a wall, both remaining motions put every point in front of both cameras.
    uv1, uv2, *_ = matches("plane", (0.02, 0.02, 0, 0.1, 0.1, -0.6))
    assert initialise_two_view(uv1, uv2, K) is None


def shaken_matches(seed, baseline=0.2):
    """Return matches in the middle of the image, of a shallow scene, taken with a rolling shutter by a shaking hand."""
    rng = np.random.default_rng(seed)
    uv1 = np.array([320.0, 240.0]) + rng.uniform(-0.5, 0.5, (250, 2)) * (300, 250)
    rays = np.c_[(uv1 - K[:2, 2]) / K.diagonal()[:2], np.ones(250)]
    xyz = rays * rng.uniform(4, 6, 250)[:, None]
    direction = rng.normal(size=3) * (1.0, 1.0, 0.3)
    c2Tc1 = exp_se3(np.r_[rng.normal(0, 0.015, 3), baseline * direction / np.linalg.norm(direction)])
    in2 = xyz @ c2Tc1[:3, :3].T + c2Tc1[:3, 3]
    uv2 = in2[:, :2] / in2[:, 2:] * K.diagonal()[:2] + K[:2, 2]
    uv2 += 2.0 * rng.normal(size=2) * (uv1[:, 1:] - 240.0) / 240.0
    return *(uv + 0.8 * rng.standard_normal(uv.shape) for uv in (uv1, uv2)), c2Tc1


def test_a_motion_with_a_rival_starts_no_map():
    # RANSAC's best motion was more than 100 degrees wrong for most of these seeds, and nothing told.
    started = 0
    for seed in (57, 67, 68, 71, 94, 104, 112, 118, 122, 137, *range(30)):
        uv1, uv2, c2Tc1 = shaken_matches(seed)
        view = initialise_two_view(uv1, uv2, K)
        if view is not None:
            started += 1
            check_motion(view.c2Tc1, c2Tc1, 0.05, 25.0)
    assert started >= 12


def test_more_parallax_leaves_one_motion():
    for seed in range(12):
        uv1, uv2, c2Tc1 = shaken_matches(seed, baseline=0.6)
        view = initialise_two_view(uv1, uv2, K)
        assert view is not None
        check_motion(view.c2Tc1, c2Tc1, 0.03, 10.0)


def test_useless_matches_are_refused():
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(0, 480, (2, 200, 2))
    assert initialise_two_view(*anywhere, K) is None
    assert initialise_two_view(np.zeros((0, 2)), np.zeros((0, 2)), K) is None
    assert initialise_two_view(anywhere[0, :30], anywhere[1, :30], K) is None
    assert initialise_two_view(np.full((100, 2), 50.0), np.full((100, 2), 50.0), K) is None
    assert initialise_two_view(anywhere[0], anywhere[0], K) is None
    line = np.repeat(np.linspace(0, 400, 200)[:, None], 2, axis=1)
    assert initialise_two_view(line, line + np.array([5.0, 5.0]), K) is None
    assert initialise_two_view(np.full((100, 2), np.nan), anywhere[0, :100], K) is None


def test_the_same_seed_gives_the_same_result():
    uv1, uv2, *_ = matches("deep", SIDEWAYS)
    a, b = (initialise_two_view(uv1, uv2, K, seed=7) for _ in range(2))
    np.testing.assert_array_equal(a.c2Tc1, b.c2Tc1)
    np.testing.assert_array_equal(a.xyz, b.xyz)


def rays_of(pose, xyz):
    p = xyz @ pose[:3, :3].T + pose[:3, 3]
    return p[:, :2] / p[:, 2:]


@pytest.mark.parametrize("twist", [SIDEWAYS, (0, 0, 0, 0, 0, -1.0), (0.3, 0.2, 0.5, 1.0, 0, 0)])
def test_triangulation_of_exact_rays(twist):
    rng = np.random.default_rng(0)
    c1Tw = exp_se3(rng.normal(0, 0.3, 6))
    c2Tw = exp_se3(np.array(twist)) @ c1Tw
    inside = np.c_[rng.uniform(-2, 2, (300, 2)), rng.uniform(3, 30, 300)]
    xyz = (inside - c1Tw[:3, 3]) @ c1Tw[:3, :3]
    found = triangulate_pairs(c1Tw, c2Tw, rays_of(c1Tw, xyz), rays_of(c2Tw, xyz))
    np.testing.assert_allclose(found, xyz, rtol=1e-6, atol=1e-6)


def test_triangulation_has_the_least_reprojection_error():
    rng = np.random.default_rng(1)
    c1Tw, c2Tw = np.eye(4), exp_se3(np.array(SIDEWAYS))
    xyz = np.c_[rng.uniform(-2, 2, (40, 2)), rng.uniform(3, 10, 40)]
    r1, r2 = (rays_of(T, xyz) + 2e-3 * rng.standard_normal((40, 2)) for T in (c1Tw, c2Tw))

    def error(points, k):
        return np.r_[rays_of(c1Tw, points[None])[0] - r1[k], rays_of(c2Tw, points[None])[0] - r2[k]]

    found = triangulate_pairs(c1Tw, c2Tw, r1, r2)
    for k in range(40):
        best = least_squares(error, xyz[k], args=(k,), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert np.sum(error(found[k], k) ** 2) <= 2 * best.cost * (1 + 1e-4)


def test_triangulation_without_a_baseline_or_behind_fails_every_check():
    rays = np.array([[0.1, 0.2], [0.0, 0.0]])
    parallel = triangulate_pairs(np.eye(4), exp_se3(np.array([0, 0, 0, 1.0, 0, 0])), rays, rays)
    assert not (np.isfinite(parallel).all(axis=1) & (parallel[:, 2] < 1e6)).any()
    assert np.isnan(triangulate_pairs(np.eye(4), np.eye(4), rays, rays)).all()
    crossed = triangulate_pairs(np.eye(4), exp_se3(np.array([0, 0, 0, -1.0, 0, 0])), rays, rays + np.array([0.1, 0.0]))
    assert (crossed[:, 2] < 0).all()
    assert triangulate_pairs(np.eye(4), np.eye(4), np.zeros((0, 2)), np.zeros((0, 2))).shape == (0, 3)
