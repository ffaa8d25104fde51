"""The method's sparse terms against hand-computed scenes and finite differences."""

import math

import pytest
import torch

from prgbd.functional.sparse_losses import (
    anchored,
    depth_consistency,
    depth_transfer,
    matched_pixels,
    sample_patches,
    transferred,
)
from prgbd.functional.warping import invert_rigid, transformation_from_parameters

K = torch.tensor([[[20.0, 0, 9.5], [0, 20.0, 7.5], [0, 0, 1]]]).double()
HEIGHT, WIDTH = 16, 20


def translation(x=0.0, y=0.0, z=0.0):
    T = torch.eye(4, dtype=torch.float64)[None].clone()
    T[0, :3, 3] = torch.tensor([x, y, z])
    return T


def flat(depth):
    return torch.full((1, 1, HEIGHT, WIDTH), depth, dtype=torch.float64)


def plane(wTc):
    """Depth map, from camera ``wTc`` (3x4 or 4x4), of the slanted world plane n.X = 4 with n = (0.3, 0.2, 1)."""
    normal = torch.tensor([0.3, 0.2, 1.0]).double()
    y, x = torch.meshgrid(torch.arange(HEIGHT).double(), torch.arange(WIDTH).double(), indexing="ij")
    rays = torch.stack([(x - 9.5) / 20, (y - 7.5) / 20, torch.ones_like(x)], dim=-1)
    R, t = wTc[0, :3, :3], wTc[0, :3, 3]
    return ((4 - normal @ t) / (rays @ (R.T @ normal)))[None, None]


def patches(depth, uv, patch=5):
    return sample_patches(depth, torch.tensor(uv).double(), patch)


def both_ways(depth_a, depth_b, uv_a, uv_b, bTa, mask=None, **options):
    uv = torch.tensor(uv_a).double(), torch.tensor(uv_b).double()
    mask = torch.ones(uv[0].shape[:2], dtype=torch.bool) if mask is None else mask
    return depth_transfer((depth_a, depth_b), uv, K, bTa, mask, **options)


def test_patches_hold_the_neighbourhood_row_by_row():
    depth = 1 / torch.arange(1, HEIGHT * WIDTH + 1).double().view(1, 1, HEIGHT, WIDTH)
    found = patches(depth, [[[6.0, 5.0]]], 3)
    expected = 1 / depth[0, 0, 4:7, 5:8].reshape(-1)
    assert torch.allclose(1 / found.depth[0, 0], expected)
    assert found.pixels[0, 0, 0].tolist() == [5.0, 4.0]
    assert found.pixels[0, 0, 1].tolist() == [6.0, 4.0]
    assert found.inside.all()


def test_interpolation_is_exact_on_a_plane():
    depth = plane(translation())
    found = patches(depth, [[[6.3, 5.8]]], 1)
    ray = torch.tensor([(6.3 - 9.5) / 20, (5.8 - 7.5) / 20, 1.0]).double()
    assert found.depth.item() == pytest.approx((4 / (ray @ torch.tensor([0.3, 0.2, 1.0]).double())).item(), rel=1e-6)


def test_patches_over_the_border_are_marked():
    found = patches(flat(2.0), [[[0.0, 7.0], [WIDTH - 1.0, HEIGHT - 1.0]]], 3)
    assert found.inside[0, 0].view(3, 3)[:, 0].sum() == 0
    assert found.inside[0, 0].view(3, 3)[:, 1:].all()
    assert found.inside[0, 1].sum() == 4
    assert torch.isfinite(found.depth).all()


def test_transfer_of_a_wall_ahead_by_hand():
    """Camera b stands 1 m closer to a wall: 5 m in a must be 4 m in b; 4.3 m in b is wrong by 0.3 both ways."""
    uv = [[[9.5, 7.5], [4.0, 6.0]]]
    closer = translation(z=-1.0)
    assert both_ways(flat(5.0), flat(4.0), uv, uv, closer).item() == pytest.approx(0, abs=1e-12)
    wrong = both_ways(flat(5.0), flat(4.3), uv, uv, closer)
    assert wrong.item() == pytest.approx(0.6)
    assert both_ways(flat(5.0), flat(4.3), uv, uv, closer, reduction="sum").item() == pytest.approx(0.6 * 2 * 25)


def test_transfer_of_a_turned_camera_by_hand():
    """A camera turned by 0.1 rad about y sees the point straight ahead of the other at depth 5 cos(0.1)."""
    bTa = transformation_from_parameters(torch.tensor([[0.0, 0.1, 0.0]]).double(), torch.zeros(1, 3).double())
    moved = transferred(patches(flat(5.0), [[[9.5, 7.5]]], 1), K, bTa)
    assert moved[..., 2].item() == pytest.approx(5 * torch.cos(torch.tensor(0.1)).item(), rel=1e-6)


def slanted_pair():
    """Two views of the slanted plane with matching keypoints: depth maps, keypoints, and the transform."""
    wTa, wTb = translation(), translation(x=0.3, y=-0.1, z=0.4)
    depth_a, depth_b = plane(wTa), plane(wTb)
    bTa = invert_rigid(wTb) @ wTa
    uv_a = torch.tensor([[[8.2, 6.9], [11.0, 9.4]]]).double()
    points = transferred(sample_patches(depth_a, uv_a, 1), K, bTa)[:, :, 0]
    uv_b = points[..., :2] / points[..., 2:] * 20 + K[:, :2, 2]
    return depth_a, depth_b, uv_a.tolist(), uv_b.tolist(), bTa


def test_transfer_of_a_slanted_plane_vanishes_at_the_true_depth():
    """Moved neighbours hit the same surface points; neighbours at the same offset do not quite."""
    depth_a, depth_b, *rest = slanted_pair()
    assert both_ways(depth_a, depth_b, *rest, patch=1).item() == pytest.approx(0, abs=1e-6)
    assert both_ways(depth_a, depth_b, *rest, patch=5).item() == pytest.approx(0, abs=1e-6)
    assert 0.01 < both_ways(depth_a, depth_b, *rest, patch=5, matching="offset").item() < 0.2
    assert both_ways(depth_a * 1.1, depth_b, *rest).item() > 0.5


def test_the_average_halves_both_directions():
    depth_a, depth_b, *rest = slanted_pair()
    mean, average = (both_ways(depth_a * 1.2, depth_b, *rest, reduction=r).item() for r in ("mean", "average"))
    assert average == pytest.approx(mean / 2)
    assert average > 0.2


def test_anchored_transfer_tells_a_wrong_scale_on_which_both_views_agree():
    """Two views of a wall side by side: predictions that are 30 % too large agree, but not with SLAM's 5 m."""
    uv_a, uv_b = [[[9.5, 7.5]]], [[[7.5, 7.5]]]
    aside = translation(x=-0.5)
    slam = torch.full((1, 1), 5.0).double()
    assert both_ways(flat(6.5), flat(6.5), uv_a, uv_b, aside).item() == pytest.approx(0, abs=1e-9)
    assert both_ways(flat(6.5), flat(6.5), uv_a, uv_b, aside, anchors=(slam, slam)).item() == pytest.approx(3.0)
    assert both_ways(flat(5.0), flat(5.0), uv_a, uv_b, aside, anchors=(slam, slam)).item() == pytest.approx(0, abs=1e-9)


def test_anchored_transfer_vanishes_at_the_truth_and_keeps_the_shape_of_the_other_view():
    depth_a, depth_b, uv_a, uv_b, bTa = slanted_pair()
    uv = torch.tensor(uv_a).double(), torch.tensor(uv_b).double()
    anchors = tuple(sample_patches(d, p, 1).depth[..., 0] for d, p in zip((depth_a, depth_b), uv, strict=True))
    assert both_ways(depth_a, depth_b, uv_a, uv_b, bTa, anchors=anchors).item() == pytest.approx(0, abs=1e-6)
    # The scale of the moved patch is SLAM's, whatever its view predicts.
    patch = sample_patches(depth_a, uv[0], 3)
    same = anchored(patch._replace(depth=patch.depth * 1.4), anchors[0])
    assert torch.allclose(same.depth, patch.depth)
    off = (depth_b * 1.1).requires_grad_()
    both_ways(depth_a, off, uv_a, uv_b, bTa, anchors=anchors).backward()
    assert off.grad.sum() > 0.5  # too deep: descent brings it nearer


def test_both_matchings_agree_on_the_keypoint_itself():
    depth_a, depth_b, *rest = slanted_pair()
    losses = [both_ways(depth_a * 1.2, depth_b, *rest, patch=1, matching=m).item() for m in ("projected", "offset")]
    assert losses[0] == losses[1] > 0.5


def test_neighbours_are_matched_around_the_tracked_keypoint():
    """A wall at 4 m seen from 5 m is magnified by 5/4 about the keypoint, wherever the keypoint was tracked to."""
    moved = transferred(patches(flat(5.0), [[[9.0, 7.0]]], 3), K, translation(z=-1.0))
    found = matched_pixels(moved, torch.tensor([[[3.0, 4.0]]]).double(), K)
    assert found[0, 0, 4].tolist() == [3.0, 4.0]
    assert found[0, 0, 5].tolist() == pytest.approx([4.25, 4.0])
    assert found[0, 0, 0].tolist() == pytest.approx([1.75, 2.75])


def test_padding_and_empty_images_do_not_count():
    uv = [[[9.5, 7.5], [1e6, 0.0]]]
    mask = torch.tensor([[True, False]])
    loss = both_ways(flat(5.0), flat(4.3), uv, uv, translation(z=-1.0), mask)
    assert loss.item() == pytest.approx(0.6)
    assert both_ways(flat(5.0), flat(4.3), uv, uv, translation(z=-1.0), ~mask & mask).item() == 0
    none = torch.zeros(1, 0, dtype=torch.bool)
    assert depth_consistency(flat(5.0), torch.zeros(1, 0, 2).double(), torch.zeros(1, 0).double(), none).item() == 0


def test_consistency_by_hand():
    """Two points off by 1 and 3 in one image, none in the other: (1 + 3) / 2 averaged over two images."""
    depth = torch.cat([flat(5.0), flat(9.0)])
    uv = torch.tensor([[[3.0, 4.0], [10.5, 7.25]], [[0.0, 0.0], [0.0, 0.0]]]).double()
    slam = torch.tensor([[4.0, 8.0], [0.0, 0.0]]).double()
    mask = torch.tensor([[True, True], [False, False]])
    assert depth_consistency(depth, uv, slam, mask).item() == pytest.approx(1.0)


def test_gradients_agree_with_finite_differences():
    torch.manual_seed(0)
    a = (3 + torch.rand(2, 1, 8, 9, dtype=torch.float64)).requires_grad_()
    b = (3 + torch.rand(2, 1, 8, 9, dtype=torch.float64)).requires_grad_()
    uv_a = torch.rand(2, 3, 2, dtype=torch.float64) * 4 + 2
    uv_b = torch.rand(2, 3, 2, dtype=torch.float64) * 4 + 2
    mask = torch.tensor([[True, True, False], [True, True, True]])
    bTa = transformation_from_parameters(
        torch.tensor([[0.1, -0.2, 0.05], [0.0, 0.1, 0.0]]).double(),
        torch.tensor([[0.2, -0.1, 0.4], [0.1, 0.0, -0.3]]).double(),
    )
    intrinsics = K.expand(2, 3, 3)

    def transfer(a, b, **options):
        return depth_transfer((a, b), (uv_a, uv_b), intrinsics, bTa, mask, **options)

    # Matches are measurements without gradient, which finite differences cannot know: so there the keypoint alone.
    assert torch.autograd.gradcheck(lambda a, b: transfer(a, b, matching="projected", patch=1), (a, b))
    assert torch.autograd.gradcheck(lambda a, b: transfer(a, b, matching="offset"), (a, b))
    assert torch.autograd.gradcheck(lambda a, b: transfer(a, b, matching="offset", reduction="sum"), (a, b))
    slam = torch.rand(2, 3, dtype=torch.float64) + 5
    assert torch.autograd.gradcheck(lambda a: depth_consistency(a, uv_a, slam, mask), a)
    # The shape of a moved patch has no gradient either; its middle is SLAM's.
    anchors = slam, torch.rand(2, 3, dtype=torch.float64) + 5
    assert torch.autograd.gradcheck(lambda a, b: transfer(a, b, patch=1, anchors=anchors), (a, b))


@pytest.mark.parametrize(("residual", "least", "most"), [("absolute", 0.5, 0.9), ("log", 0.95, 1.05)])
def test_only_the_log_residual_is_lowest_at_the_true_scale_of_noisy_depth(residual, least, most):
    """Two noisy predictions of the same points, 1 m of forward motion: which common factor makes them agree best?"""
    generator = torch.Generator().manual_seed(0)
    height, width = 200, 300
    z = 10.0 + 10.0 * torch.rand(1, 1, height, width, generator=generator)
    noise = [torch.exp(0.1 * torch.randn(z.shape, generator=generator)) for _ in range(2)]
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    uv = torch.stack([u.reshape(1, -1), v.reshape(1, -1)], dim=-1).float()
    mask = torch.ones(uv.shape[:2], dtype=torch.bool)
    bTa = translation(z=-1.0).float()
    scales = torch.linspace(0.5, 1.5, 51)
    losses = [
        depth_transfer(
            (s * z * noise[0], s * (z - 1.0) * noise[1]), (uv, uv), K.float(), bTa, mask, patch=1, residual=residual
        )
        for s in scales
    ]
    best = float(scales[int(torch.stack(losses).argmin())])
    assert least <= best <= most


def test_the_log_residual_does_not_change_with_the_unit():
    depth, slam = torch.full((1, 1, 8, 8), 3.0), torch.full((1, 2), 2.0)
    uv, mask = torch.full((1, 2, 2), 4.0), torch.ones(1, 2, dtype=torch.bool)
    metres = depth_consistency(depth, uv, slam, mask, residual="log")
    centimetres = depth_consistency(100 * depth, uv, 100 * slam, mask, residual="log")
    assert metres.item() == pytest.approx(math.log(1.5), rel=1e-5)
    assert centimetres.item() == pytest.approx(metres.item(), rel=1e-5)
