"""What a model wants its images to look like: the rules of its image processor, carried out in torch.

Transformers' processors work on one PIL image or need torchvision, and no gradient passes them. The rules themselves
are a few numbers in ``preprocessor_config.json``: mean, standard deviation, size and the multiple it must have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
HALVES = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
NONE = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
PIL_BILINEAR = 2

# Mean and deviation, (height, width), multiple, keep aspect ratio, mode: the processors' own defaults by architecture,
# for a folder that holds a model alone.
_DEFAULTS: dict[str, tuple[tuple[tuple[float, ...], tuple[float, ...]], tuple[int, int], int, bool, str]] = {
    "depth_anything": (IMAGENET, (518, 518), 14, True, "bicubic"),
    "prompt_depth_anything": (IMAGENET, (756, 756), 14, True, "bicubic"),
    "zoedepth": (HALVES, (384, 512), 32, True, "bilinear"),
    "glpn": (NONE, (480, 640), 32, False, "bilinear"),
    "depth_pro": (HALVES, (1536, 1536), 1536, False, "bilinear"),
}
_DPT = (HALVES, (384, 384), 16, False, "bicubic")


@dataclass(frozen=True)
class InputRules:
    """How an image becomes the model's input.

    Attributes:
        mean: Of the three channels, subtracted from RGB in [0, 1].
        std: Their standard deviations, divided by.
        size: (height, width) that the processor aims at, pixels.
        multiple: Both sides of the input must be multiples of this.
        keep_aspect_ratio: Whether the processor changes ``size`` so that the shape of the image stays.
        mode: ``bicubic`` or ``bilinear``.
        square: Whether the model takes square images alone, as DPT's plain vision transformer does.
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]
    size: tuple[int, int]
    multiple: int
    keep_aspect_ratio: bool
    mode: str
    square: bool = False

    def nearest(self, height: float, width: float) -> tuple[int, int]:
        """Return the size with the model's multiple that is nearest to ``height`` x ``width`` pixels."""
        if self.square:
            height = width = (height * width) ** 0.5
        sides = (max(1, round(side / self.multiple)) * self.multiple for side in (height, width))
        rows, columns = sides
        return rows, columns

    def processor_size(self, height: int, width: int) -> tuple[int, int]:
        """Return the size that the image processor would give to an image of ``height`` x ``width`` pixels."""
        tall, wide = self.size[0] / height, self.size[1] / width
        if self.keep_aspect_ratio:
            tall = wide = wide if abs(1 - wide) < abs(1 - tall) else tall  # scale as little as possible
        return self.nearest(tall * height, wide * width)

    def resize(self, images: Tensor, size: tuple[int, int]) -> Tensor:
        """Resize (B, 3, H, W) RGB in [0, 1] with smoothing; differentiable."""
        if tuple(images.shape[2:]) == size:
            return images
        return F.interpolate(images, size, mode=self.mode, align_corners=False, antialias=True).clamp(0.0, 1.0)

    def normalise(self, images: Tensor) -> Tensor:
        """Subtract the mean of (B, 3, H, W) RGB in [0, 1] and divide by the deviation."""
        mean = torch.tensor(self.mean, dtype=images.dtype, device=images.device)[:, None, None]
        std = torch.tensor(self.std, dtype=images.dtype, device=images.device)[:, None, None]
        return (images - mean) / std


def input_rules(
    model_type: str, processor: Mapping[str, Any] | None, patch: int = 1, square: bool = False
) -> InputRules:
    """Return the rules of a model.

    Args:
        model_type: The architecture, as in ``config.json``.
        processor: The content of ``preprocessor_config.json``; None takes the architecture's defaults.
        patch: Side of the model's patches, which the size must be a multiple of whatever the processor says.
        square: Whether the model takes square images alone.
    """
    (mean, std), size, multiple, keep, mode = _DEFAULTS.get(model_type, _DPT)
    given = dict(processor or {})
    if given.get("do_normalize", bool(given.get("image_mean"))):
        mean, std = (
            tuple(map(float, given.get(key) or own)) for key, own in (("image_mean", mean), ("image_std", std))
        )
    elif processor is not None:
        mean, std = NONE
    if isinstance(given.get("size"), Mapping) and "height" in given["size"]:
        size = (int(given["size"]["height"]), int(given["size"]["width"]))
    elif isinstance(given.get("size"), int):
        size = (given["size"], given["size"])
    stated = given.get("ensure_multiple_of") or given.get("size_divisor")
    if stated and stated >= 1:
        multiple = int(stated)
    multiple = multiple if multiple % patch == 0 else patch
    if "resample" in given:
        mode = "bilinear" if given["resample"] == PIL_BILINEAR else "bicubic"
    rules = InputRules(mean, std, size, multiple, bool(given.get("keep_aspect_ratio", keep)), mode, square)
    return replace(rules, size=rules.nearest(*size))
