"""Dense loss terms: photometric error with automatic masking, and edge-aware smoothness (Monodepth2).

All terms run in float32 even under mixed precision: SSIM's variances are differences of nearly equal numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from prgbd.core.types import DepthPrediction
from prgbd.functional.image_similarity import moments, photometric_error
from prgbd.functional.warping import reprojection, resampled, sampling_grid

TIE_BREAK = 1e-5
"""Scale of the normal noise on the identity error; decides ties of still images at random (Monodepth2)."""


def smoothness(inverse_depth: Tensor, image: Tensor) -> Tensor:
    """Edge-aware first-order smoothness of the mean-normalised inverse depth (Monodepth2).

    Args:
        inverse_depth: (B, 1, H, W) disparity or inverse depth; each image is divided by its own mean.
        image: (B, C, H, W) in [0, 1] of the same size; its edges excuse edges of depth.

    Returns:
        Scalar.
    """
    inverse = inverse_depth / (inverse_depth.mean(dim=(2, 3), keepdim=True) + 1e-7)
    total = inverse.new_zeros(())
    for dim in (2, 3):
        edge = image.diff(dim=dim).abs().mean(dim=1, keepdim=True)
        total = total + (inverse.diff(dim=dim).abs() * torch.exp(-edge)).mean()
    return total


def smoothness_loss(prediction: DepthPrediction, image: Tensor) -> Tensor:
    """Smoothness of every scale, weighted by ``1 / 2**scale``, mean over the scales; the caller applies its weight.

    Args:
        prediction: Depth maps finest first; the term is defined on the network's disparities where it has them.
        image: (B, 3, H, W) un-augmented target image in [0, 1]; averaged down to each scale.

    Returns:
        Scalar.
    """
    with torch.autocast(image.device.type, enabled=False):
        inverses = prediction.inverse_depths()
        total = image.new_zeros(())
        for scale, inverse in enumerate(inverses):
            height, width = inverse.shape[-2:]
            small = F.adaptive_avg_pool2d(image, (height, width))
            total = total + smoothness(inverse.to(image.dtype), small) / 2**scale
        return total / len(inverses)


def upsampled_depth(depth: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize depth (B, 1, h, w) by its *inverse*, bilinearly.

    Monodepth2 upsamples its disparity, of which the inverse depth is an affine function, so this is the same.
    """
    if tuple(depth.shape[-2:]) == size:
        return depth
    return 1 / F.interpolate(1 / depth, size, mode="bilinear", align_corners=False)


def photometric_loss(
    prediction: DepthPrediction,
    target: Tensor,
    sources: Sequence[Tensor],
    K: Tensor,
    sTt: Sequence[Tensor],
    automask: bool = True,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Multi-scale photometric loss with per-pixel minimum over the sources and automatic masking (Monodepth2).

    Every scale's depth is upsampled to the target's size before warping. With ``automask`` the error of *not* warping
    joins the minimum, so pixels that look the same without motion (a still camera, an object moving along) train
    nothing.

    Args:
        prediction: Depth maps of the target, finest first.
        target: (B, 3, H, W) un-augmented image in [0, 1].
        sources: S images (B, 3, H, W), un-augmented.
        K: (B, 3, 3) intrinsics at the size of the target, pixels.
        sTt: S transforms (B, 4, 4) from target camera to source camera.
        automask: Whether the identity error joins the minimum.
        generator: Random numbers that break ties of the automatic mask; the global ones if None.

    Returns:
        Scalar, mean over pixels and scales.
    """
    with torch.autocast(target.device.type, enabled=False):
        with torch.no_grad():
            target_moments = moments(target)
            # The identity error does not depend on depth: once for all scales, and without gradient.
            still = torch.cat([photometric_error(s, target, target_moments) for s in sources], 1) if automask else None
        size = (target.shape[-2], target.shape[-1])
        # Neither does what of the warp depends on the motion alone.
        motions = [reprojection(K, T, size, size) for T in sTt]
        total = target.new_zeros(())
        for depth in prediction.depths:
            full = upsampled_depth(depth.to(target.dtype), size)
            errors = [
                photometric_error(resampled(source, sampling_grid(full, motion)), target, target_moments)
                for source, motion in zip(sources, motions, strict=True)
            ]
            if still is not None:
                noise = torch.randn(still.shape, generator=generator, device=still.device, dtype=still.dtype)
                errors.append(still + TIE_BREAK * noise)
            total = total + torch.cat(errors, dim=1).amin(dim=1).mean()
        return total / len(prediction.depths)
