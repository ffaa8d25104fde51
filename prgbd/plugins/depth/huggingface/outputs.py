"""What a model's output means: depth or disparity, metres or not; and a scale for disparity that has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import ConfigError

KINDS = ("auto", "depth", "disparity")
NEAR_SHARE = 0.98  # the disparity of the probe that this share of its pixels is below lies at the near distance


@dataclass(frozen=True)
class Meaning:
    """What the numbers are.

    Attributes:
        kind: ``depth`` or ``disparity``.
        depth_kind: What the depth made of them is.
        farthest: The largest depth the model was made for, metres; None if it does not say.
    """

    kind: str
    depth_kind: DepthKind
    farthest: float | None = None


def meaning_of(config: Any, output: str) -> Meaning:
    """Return what the output of a model is.

    Depth Anything says it in its configuration, GLPN and ZoeDepth are metric, DPT is MiDaS' relative disparity unless
    its backbone is DINOv2 (those are trained on metres), Depth Pro gives inverse depth up to the focal length.

    Args:
        config: The model's configuration.
        output: The user's choice: ``auto``, ``depth`` or ``disparity``.

    Raises:
        ConfigError: If the choice is none, or ``auto`` does not know the architecture.
    """
    if output not in KINDS:
        raise ConfigError(f"depth.output={output} is unknown; choose {', '.join(KINDS)}.")
    known = _known(config)
    if output == "auto":
        if known is None:
            raise ConfigError(
                f"It is not known whether models of the architecture '{config.model_type}' give depth or disparity; "
                "set depth.output=depth or depth.output=disparity."
            )
        return known
    if known is not None and known.kind == output:
        return known
    kind = DepthKind.SCALE if output == "depth" else DepthKind.AFFINE_DISPARITY
    return Meaning(output, kind, farthest=known.farthest if known else None)


def _known(config: Any) -> Meaning | None:
    kind = config.model_type
    if kind in ("depth_anything", "prompt_depth_anything"):
        if config.depth_estimation_type == "metric":
            return Meaning("depth", DepthKind.METRIC, float(config.max_depth or 80.0))
        return Meaning("disparity", DepthKind.AFFINE_DISPARITY)
    if kind == "zoedepth":
        farthest = max((float(c["max_depth"]) for c in config.bin_configurations or ()), default=80.0)
        return Meaning("depth", DepthKind.METRIC, farthest)
    if kind == "glpn":
        return Meaning("depth", DepthKind.METRIC, float(config.max_depth))
    if kind == "dpt":
        backbone = getattr(config.backbone_config, "model_type", None)
        if backbone == "dinov2":
            return Meaning("depth", DepthKind.METRIC)
        return Meaning("disparity", DepthKind.AFFINE_DISPARITY)
    return Meaning("disparity", DepthKind.SCALE) if kind == "depth_pro" else None


def disparity_unit(predict: Callable[[Tensor], Tensor], height: int, width: int) -> float:
    """Return the disparity that a model gives to what is near, to measure all its disparities in.

    Relative disparities differ by a factor of a hundred between models. The unit comes from a picture that never
    changes, and not from the user's first image, so that a model means the same depth in every run.

    Args:
        predict: From (1, 3, H, W) RGB in [0, 1] to (1, h, w) disparity.
        height: Of the picture, pixels.
        width: Likewise.
    """
    with torch.no_grad():
        disparity = predict(probe(height, width)).float().flatten()
    unit = float(torch.quantile(disparity[:: max(1, disparity.numel() // 100_000)], NEAR_SHARE))
    return unit if unit > 0 else 1.0


def probe(height: int, width: int) -> Tensor:
    """Draw a road between two rows of houses under a sky, (1, 3, height, width) RGB in [0, 1].

    The ground and the walls carry a pattern of squares in true perspective (camera 1.6 m above the ground).
    """
    v, u = torch.meshgrid(torch.linspace(-0.5, 0.5, height), torch.linspace(-0.5, 0.5, width), indexing="ij")
    u, v = 1.6 * u, 1.6 * v * height / width - 0.02
    ground = 1.6 / v.clamp(min=1e-3)
    wall = 6.0 / u.abs().clamp(min=1e-3)
    on_ground = (v > 0) & (ground < wall)
    depth = torch.minimum(ground, wall)
    is_sky = ~on_ground & ((v * depth) < -8.0) | (depth > 200)
    along, across = depth, torch.where(on_ground, u * depth, v * depth)
    squares = ((along / 2).floor() + (across / 1.5).floor()) % 2
    shade = torch.where(on_ground, 0.3 + 0.1 * squares, 0.45 + 0.25 * squares) * (1 - depth.clamp(max=150) / 400)
    sky = 0.75 + 0.2 * (v - v.min()) / (v.max() - v.min())
    grey = torch.where(is_sky, sky, shade)
    tint = torch.tensor([0.95, 1.0, 1.05])[:, None, None]
    return (grey[None] * torch.where(is_sky, tint, 1 / tint)).clamp(0, 1)[None]
