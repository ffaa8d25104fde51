"""The dense terms against the published figures, plain arithmetic and finite differences."""

import pytest
import torch
import torch.nn.functional as F

from prgbd.core.types import DepthPrediction
from prgbd.functional import image_similarity as similarity
from prgbd.functional import losses
from prgbd.functional.warping import invert_rigid, transformation_from_parameters, warp

from .test_warping import GOLDEN, HEIGHT, WIDTH, wave


def test_photometric_error_has_the_published_figures():
    golden = GOLDEN["photometric"]
    # SSIM's variances are small differences: in single pixels the figures' own float32 rounding shows, up to 1.4e-5
    # against float64.
    a, b = wave().float(), wave(3, -2).float()
    error = similarity.photometric_error(a, b)
    assert similarity.ssim(a, b).mean().item() == pytest.approx(golden["ssim_mean"], abs=1e-6)
    assert (a - b).abs().mean().item() == pytest.approx(golden["l1_mean"], abs=1e-6)
    assert error.mean().item() == pytest.approx(golden["pe_mean"], abs=1e-6)
    assert error[0, 0, 10, 20].item() == pytest.approx(golden["pe[0,0,10,20]"], abs=2e-5)
    assert error[0, 0, 100, 600].item() == pytest.approx(golden["pe[0,0,100,600]"], abs=2e-5)


def test_smoothness_has_the_published_figure():
    y, x = torch.meshgrid(torch.arange(HEIGHT).double(), torch.arange(WIDTH).double(), indexing="ij")
    disparity = (0.5 + 0.3 * torch.sin(x / 29) * torch.cos(y / 23))[None, None]
    assert losses.smoothness(disparity, wave()).item() == pytest.approx(GOLDEN["smoothness"]["value"], rel=1e-5)
    # Mean-normalised: the unit of depth does not matter.
    assert losses.smoothness(7 * disparity, wave()).item() == pytest.approx(GOLDEN["smoothness"]["value"], rel=1e-5)


def test_smoothness_loss_halves_the_weight_per_scale():
    torch.manual_seed(1)
    image = torch.rand(2, 3, 16, 32, dtype=torch.float64)
    maps = tuple(torch.rand(2, 1, 16 >> s, 32 >> s, dtype=torch.float64) + 0.1 for s in range(3))
    expected = sum(
        losses.smoothness(d, F.interpolate(image, d.shape[-2:], mode="area")) / 2**s for s, d in enumerate(maps)
    )
    disparities = DepthPrediction(tuple(torch.ones_like(d) for d in maps), maps)
    assert losses.smoothness_loss(disparities, image).item() == pytest.approx(expected.item() / 3)
    # Without disparities the term is that of 1 / depth.
    inverted = DepthPrediction(tuple(1 / d for d in maps))
    assert losses.smoothness_loss(inverted, image).item() == pytest.approx(expected.item() / 3)


@pytest.fixture
def moving_view():
    """Two views of a textured surface: the target is rendered from the source by the true depth, so the loss is ~0."""
    torch.manual_seed(0)
    y, x = torch.meshgrid(torch.arange(48).double(), torch.arange(64).double(), indexing="ij")
    source = torch.stack([0.5 + 0.4 * torch.sin(x / 3 + c) * torch.cos(y / 4 - c) for c in range(3)])[None]
    depth = (4 + torch.sin(x / 20) + torch.cos(y / 15))[None, None]
    K = torch.tensor([[[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]]).double()
    T = transformation_from_parameters(torch.zeros(1, 3).double(), torch.tensor([[0.3, 0.1, 0.0]]).double())
    return source, warp(source, depth, K, T)[0], depth, K, T


def test_photometric_loss_is_lowest_at_the_true_depth(moving_view):
    source, target, depth, K, T = moving_view
    at = [
        losses.photometric_loss(DepthPrediction((depth * f,)), target, [source], K, [T], automask=False).item()
        for f in (0.7, 0.9, 1.0, 1.1, 1.4)
    ]
    assert at[2] == pytest.approx(0, abs=1e-12)
    assert at[0] > at[1] > at[2] < at[3] < at[4]


def test_the_minimum_forgives_one_bad_source(moving_view):
    source, target, depth, K, T = moving_view
    noise = torch.rand_like(source)
    prediction = DepthPrediction((depth,))
    good = losses.photometric_loss(prediction, target, [noise, source], K, [invert_rigid(T), T], automask=False)
    assert good.item() == pytest.approx(0, abs=1e-6)


def test_automask_ignores_what_does_not_move(moving_view):
    """A still camera: warping by a wrong pose can only be worse than not warping, so nothing trains."""
    source, _, depth, K, T = moving_view
    depth = depth.clone().requires_grad_()
    loss = losses.photometric_loss(DepthPrediction((depth,)), source, [source], K, [T], automask=True)
    loss.backward()
    assert loss.item() == pytest.approx(0, abs=1e-4)
    assert (depth.grad == 0).double().mean() > 0.95
    unmasked = losses.photometric_loss(DepthPrediction((depth,)), source, [source], K, [T], automask=False)
    assert unmasked.item() > 0.01


def test_the_tie_break_is_seeded(moving_view):
    """Where warping and not warping agree everywhere, the noise alone decides."""
    source, _, depth, K, _ = moving_view
    still = torch.eye(4).double()[None]

    def value(seed):
        generator = torch.Generator().manual_seed(seed)
        prediction = DepthPrediction((depth,))
        return losses.photometric_loss(prediction, source, [source], K, [still], generator=generator).item()

    assert value(3) == value(3)
    assert value(3) != value(4)


def test_every_scale_is_upsampled_by_inverse_depth(moving_view):
    source, target, depth, K, T = moving_view
    coarse = 1 / F.avg_pool2d(1 / depth, 4)
    full = 1 / F.interpolate(1 / coarse, (48, 64), mode="bilinear", align_corners=False)
    each = [
        losses.photometric_loss(DepthPrediction((d,)), target, [source], K, [T], automask=False) for d in (depth, full)
    ]
    both = losses.photometric_loss(DepthPrediction((depth, coarse)), target, [source], K, [T], automask=False)
    assert both.item() == pytest.approx(sum(each).item() / 2)


def test_gradients_agree_with_finite_differences(moving_view):
    source, target, depth, K, T = moving_view
    crop = (slice(None), slice(None), slice(8, 14), slice(8, 15))
    K = K.clone()
    K[:, :2, 2] = torch.tensor([3.0, 2.5])
    depth = (depth[crop] * 1.13).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda d: losses.photometric_loss(DepthPrediction((d,)), target[crop], [source[crop]], K, [T], automask=False),
        depth,
    )
    image = target[crop]
    assert torch.autograd.gradcheck(lambda d: losses.smoothness_loss(DepthPrediction((d,)), image), depth)


def test_mixed_precision_computes_the_terms_in_float32(moving_view):
    source, target, depth, K, T = (t.float() for t in moving_view)
    prediction = DepthPrediction((depth.bfloat16(),))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        loss = losses.photometric_loss(prediction, target, [source], K, [T], automask=False)
        smooth = losses.smoothness_loss(prediction, target)
    assert loss.dtype == torch.float32
    assert smooth.dtype == torch.float32
    assert loss.item() < 2e-3
