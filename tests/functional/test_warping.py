"""Geometry against the published layers' figures and against plain arithmetic."""

import json
from pathlib import Path

import pytest
import torch

from prgbd.functional import warping

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "monodepth2_layers.json").read_text())
HEIGHT, WIDTH = 192, 640


def wave(dx: float = 0, dy: float = 0) -> torch.Tensor:
    """The image A (or B, shifted) of the golden figures, (1, 3, 192, 640)."""
    y, x = torch.meshgrid(torch.arange(HEIGHT).double(), torch.arange(WIDTH).double(), indexing="ij")
    return torch.stack([0.5 + 0.4 * torch.sin((x + dx) / 17 + c) * torch.cos((y + dy) / 11 - c) for c in range(3)])[
        None
    ]


def golden_scene():
    y, x = torch.meshgrid(torch.arange(HEIGHT).double(), torch.arange(WIDTH).double(), indexing="ij")
    depth = (10 + 4 * torch.sin(x / 37) + 3 * torch.cos(y / 19))[None, None]
    K = torch.tensor([[[0.58 * WIDTH, 0, 0.5 * WIDTH], [0, 1.92 * HEIGHT, 0.5 * HEIGHT], [0, 0, 1]]]).double()
    T = torch.tensor(GOLDEN["transformation_from_parameters"]["T"]).double()[None]
    return depth, K, T


def test_transformation_has_the_published_figures():
    golden = GOLDEN["transformation_from_parameters"]
    angle, t = torch.tensor([golden["axisangle"]]), torch.tensor([golden["translation"]])
    T = warping.transformation_from_parameters(angle, t)
    inverted = warping.transformation_from_parameters(angle, t, invert=True)
    assert torch.allclose(T[0], torch.tensor(golden["T"]), atol=1e-6)
    assert torch.allclose(inverted[0], torch.tensor(golden["T_inverted"]), atol=1e-6)
    assert torch.allclose(T @ inverted, torch.eye(4), atol=1e-6)
    assert torch.allclose(warping.invert_rigid(T), inverted, atol=1e-6)


def test_rotation_is_differentiable_at_zero():
    angle = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    warping.rotation_from_axisangle(angle).sum().backward()
    assert torch.isfinite(angle.grad).all()


def test_projection_has_the_published_figures():
    depth, K, T = golden_scene()
    size = (HEIGHT, WIDTH)
    grid = warping.sampling_grid(depth, warping.reprojection(K, T, size, size))[0]
    assert grid[:, 96, 320].tolist() == pytest.approx(GOLDEN["warp"]["pix[96,320]"], abs=1e-5)
    assert grid[:, 10, 600].tolist() == pytest.approx(GOLDEN["warp"]["pix[10,600]"], abs=1e-5)


def test_warp_has_the_published_mean():
    warped, valid = warping.warp(wave(), *golden_scene())
    assert warped.mean().item() == pytest.approx(GOLDEN["warp"]["warped_mean_align_corners_true"], abs=2e-6)
    assert 0.5 < valid.double().mean() < 1


def test_without_motion_every_pixel_stays_with_intrinsics_per_sample():
    depth = torch.rand(2, 1, 5, 7, dtype=torch.float64) + 1
    K = torch.tensor([[[9.0, 0, 3], [0, 8, 2], [0, 0, 1]], [[5.0, 0, 2.5], [0, 6, 1.5], [0, 0, 1]]]).double()
    motion = warping.reprojection(K, torch.eye(4).double().expand(2, 4, 4), (5, 7), (5, 7))
    pixels = (warping.sampling_grid(depth, motion) + 1) * torch.tensor([3.0, 2.0]).double()[:, None, None]
    grid = warping.pixel_grid(5, 7, device=depth.device, dtype=depth.dtype)[:2].view(2, 5, 7)
    assert torch.allclose(pixels, grid.expand(2, -1, -1, -1), atol=1e-9)
    assert torch.allclose(K @ warping.inverse_intrinsics(K), torch.eye(3).double().expand(2, 3, 3), atol=1e-12)


def test_warp_of_a_plane_shifts_by_whole_pixels():
    """A camera that steps right by depth / f sees everything one pixel further left; the border repeats."""
    source = torch.rand(1, 3, 4, 6)
    K = torch.tensor([[[10.0, 0, 2.5], [0, 10.0, 1.5], [0, 0, 1]]])
    sTt = torch.eye(4)[None].clone()
    sTt[0, 0, 3] = -0.2
    warped, valid = warping.warp(source, torch.full((1, 1, 4, 6), 2.0), K, sTt)
    assert torch.allclose(warped[..., 1:], source[..., :-1], atol=1e-5)
    assert torch.allclose(warped[..., 0], source[..., 0], atol=1e-5)
    assert valid[0, 0, :, 1:].all()
    assert not valid[0, 0, :, 0].any()


def test_points_behind_the_camera_are_invalid_and_finite():
    depth = torch.full((1, 1, 4, 6), 2.0, requires_grad=True)
    K = torch.tensor([[[10.0, 0, 2.5], [0, 10.0, 1.5], [0, 0, 1]]])
    sTt = torch.eye(4)[None].clone()
    sTt[0, 2, 3] = -5.0
    warped, valid = warping.warp(torch.rand(1, 3, 4, 6), depth, K, sTt)
    warped.sum().backward()
    assert not valid.any()
    assert torch.isfinite(warped).all()
    assert torch.isfinite(depth.grad).all()


def test_warp_gradient_agrees_with_finite_differences():
    torch.manual_seed(0)
    # Smooth source and generic depth, so that no sample sits on a kink of the bilinear interpolation.
    y, x = torch.meshgrid(torch.arange(5).double(), torch.arange(7).double(), indexing="ij")
    source = torch.sin(x / 3 + y / 2)[None, None]
    depth = (2 + torch.rand(1, 1, 5, 7, dtype=torch.float64)).requires_grad_()
    K = torch.tensor([[[9.0, 0, 3], [0, 8, 2], [0, 0, 1]]]).double()
    T = warping.transformation_from_parameters(
        torch.tensor([[0.01, -0.02, 0.03]]).double(), torch.tensor([[0.11, -0.07, 0.1]]).double()
    )
    assert torch.autograd.gradcheck(lambda d: warping.warp(source, d, K, T)[0], depth)


def test_grid_gradient_by_depth_and_motion_agrees_with_finite_differences():
    torch.manual_seed(1)
    depth = (2 + torch.rand(2, 1, 3, 4, dtype=torch.float64)).requires_grad_()
    K = torch.tensor([[9.0, 0, 1.5], [0, 8, 1], [0, 0, 1]]).double().expand(2, 3, 3)
    angle = (0.1 * torch.randn(2, 3, dtype=torch.float64)).requires_grad_()
    t = (0.2 * torch.randn(2, 3, dtype=torch.float64)).requires_grad_()

    def grid(depth, angle, t):
        T = warping.transformation_from_parameters(angle, t)
        return warping.sampling_grid(depth, warping.reprojection(K, T, (3, 4), (3, 4)))

    assert torch.autograd.gradcheck(grid, (depth, angle, t))


def test_a_point_behind_the_camera_lands_far_outside_and_passes_no_gradient_through_its_depth():
    depth = torch.full((1, 1, 3, 4), 2.0, requires_grad=True)
    K = torch.tensor([[[9.0, 0, 1.5], [0, 8, 1], [0, 0, 1]]])
    sTt = torch.eye(4)[None].clone()
    sTt[0, 2, 3] = -5.0
    grid = warping.sampling_grid(depth, warping.reprojection(K, sTt, (3, 4), (3, 4)))
    assert (grid.abs() > 100).any(dim=1).all()
    by_depth = torch.autograd.grad(grid.sum(), depth)[0].abs()
    # Only the numerator depends on depth: the rays through the pixels, over NEAREST.
    motion = warping.reprojection(K, sTt, (3, 4), (3, 4))
    expected = (motion.rays[:, :2].sum(dim=1) / warping.NEAREST).abs().view(1, 1, 3, 4)
    assert torch.allclose(by_depth, expected)
