"""Depth models of the Transformers library as depth estimators: Depth Anything, DPT, ZoeDepth, GLPN and others."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from prgbd.core.depth import DepthEstimator, load_matching
from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Positive, Side
from prgbd.core.types import DepthPrediction
from prgbd.core.validation import check_image
from prgbd.io.files import atomic_path
from prgbd.plugins.depth.huggingface.inputs import input_rules
from prgbd.plugins.depth.huggingface.loading import PROCESSOR, WEIGHTS, load_model, read_weights
from prgbd.plugins.depth.huggingface.outputs import disparity_unit, meaning_of

log = logging.getLogger(__name__)
OWN = "prgbd.json"
NEAR = 2.0  # where the near disparity of the probe lies, in units of depth; the sky is at max_depth
SHAPE_TOLERANCE = 1.15


class HuggingFaceDepth(DepthEstimator):
    """Any ``AutoModelForDepthEstimation``.

    Relative disparity d (Depth Anything, DPT) becomes depth 1 / (d / (2 u) + 1 / max_depth): its zero is the far end,
    as it was trained (Ranftl et al., TPAMI 2022), and u is the model's own unit, so that what is near lies at about 2.
    Its true scale and shift are another pair in every image, which is declared (``affine_disparity``) and left to SLAM
    and to the training. Metric depth stays what it is.

    Images are resized to ``input_size`` in torch by the rules of the model's image processor, then, if need be, to
    the model's multiple. Paddings and flips that some processors add at test time are left out.

    Args:
        model: A name on the hub (``depth-anything/Depth-Anything-V2-Small-hf``) or a folder with such a model.
        weights: A folder that ``save_weights`` wrote; without ``model`` it is the model.
        output: What the model gives: ``depth``, ``disparity``, or ``auto`` by its architecture and configuration.
        height: Input height in pixels; None takes the image processor's.
        width: Input width likewise. A shape like the recordings' is best.
        min_depth: Nearest depth that comes out.
        max_depth: Farthest depth; None is what a metric model says of itself, or 100.
        disparity_scale: What a relative disparity is multiplied by to be an inverse depth; None finds it as above.

    Raises:
        ConfigError: If an option has a value that cannot work.
        WeightsError: If the model cannot be loaded or estimates no depth.
    """

    weights_file = WEIGHTS
    disparity_scale: Tensor

    def __init__(
        self,
        model: str | Path | None = None,
        weights: str | Path | None = None,
        output: str = "auto",
        height: Side | None = None,
        width: Side | None = None,
        min_depth: Positive = 0.1,
        max_depth: Positive | None = None,
        disparity_scale: Positive | None = None,
    ) -> None:
        super().__init__()
        source = model if model is not None else weights
        if source is None:
            raise ConfigError("depth=huggingface needs depth.model: a name on the hub (OWNER/NAME) or a folder.")
        network, self._processor = load_model(str(source))
        self.model: Any = network
        config: Any = self.model.config
        self.meaning = meaning_of(config, output)
        self.depth_kind = self.meaning.depth_kind
        self.rules = input_rules(config.model_type, self._processor, _patch(config), _square(config))
        self._chosen_size = height is not None or width is not None
        self.input_size = (int(height or self.rules.size[0]), int(width or self.rules.size[1]))
        if min(self.input_size) < 32:
            raise ConfigError(f"depth.height and depth.width are {self.input_size}; both must be at least 32.")
        farthest = float(max_depth if max_depth is not None else self.meaning.farthest or 100.0)
        if not 0 < min_depth < farthest:
            raise ConfigError(f"depth.min_depth={min_depth:g} must lie between 0 and depth.max_depth={farthest:g}.")
        self.depth_range = (float(min_depth), farthest)
        self.register_buffer("disparity_scale", torch.tensor(self._scale(disparity_scale, Path(str(source)))))
        if weights is not None and source is not weights:
            self.load_weights(Path(weights))

    def forward(self, images: Tensor) -> DepthPrediction:
        """Predict depth for (B, 3, H, W) RGB in [0, 1], at the same size."""
        raw = self._raw(images)[:, None]
        nearest, farthest = self.depth_range
        # Inverse depth is what is interpolated: an edge must not smear towards the far side.
        inverse = raw * self.disparity_scale + 1 / farthest if self._is_disparity else 1 / raw.clamp(nearest, farthest)
        if inverse.shape[2:] != images.shape[2:]:
            inverse = F.interpolate(inverse, images.shape[2:], mode="bilinear", align_corners=False)
        return DepthPrediction((1 / inverse.clamp(1 / farthest, 1 / nearest),))

    def preprocess(self, image: NDArray[np.uint8]) -> Tensor:
        """Resize an (H, W, 3) uint8 RGB image to ``input_size`` as the model's processor resizes: (3, h, w) float32."""
        check_image(image, "A depth network")
        self._warn_of_shape(*image.shape[:2])
        # A copy: what comes from a memory map or a video reader may be read-only.
        tensor = torch.from_numpy(image.copy()).permute(2, 0, 1).float().div_(255.0)
        return self.rules.resize(tensor[None], self.input_size)[0]

    def save_weights(self, folder: Path) -> None:
        """Write the model as Transformers does (``config.json``, ``model.safetensors``) with its processor's rules."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.model.save_pretrained(folder)
        own = {"disparity_scale": float(self.disparity_scale)}
        for name, content in ((PROCESSOR, self._processor), (OWN, own)):
            if content is not None:
                with atomic_path(folder / name) as temporary:
                    temporary.write_text(json.dumps(content, indent=2), encoding="utf-8")

    def load_weights(self, folder: Path) -> None:
        """Read what ``save_weights`` wrote.

        Raises:
            WeightsError: If a file is missing, unreadable or made for another network.
        """
        state, path = read_weights(Path(folder))
        load_matching(self.model, state, path)
        scale = _stored_scale(path.parent)
        if scale is not None:
            self.disparity_scale.fill_(scale)

    @property
    def _is_disparity(self) -> bool:
        return self.meaning.kind == "disparity"

    def _raw(self, images: Tensor) -> Tensor:
        """Return what the model says of (B, 3, H, W) RGB in [0, 1]: (B, h, w), not negative."""
        size = self.rules.nearest(*images.shape[2:])
        pixels = self.rules.normalise(self.rules.resize(images, size))
        if torch.is_inference_mode_enabled():
            # Some backbones (BEiT) keep index tensors between calls; made in inference mode, they could not train.
            with torch.inference_mode(False), torch.no_grad():
                raw: Tensor = self.model(pixel_values=pixels.clone()).predicted_depth
        else:
            raw = self.model(pixel_values=pixels).predicted_depth
        return raw.float().clamp(min=0.0)

    def _scale(self, chosen: float | None, source: Path) -> float:
        """The factor from disparity to inverse depth: chosen, stored beside the model, or measured on the probe."""
        if not self._is_disparity:
            return 1.0
        stored = _stored_scale(source)
        if chosen is not None or stored is not None:
            return float(chosen if chosen is not None else stored)  # type: ignore[arg-type]
        was_training = self.training
        self.eval()
        unit = disparity_unit(self._raw, *self.rules.size)
        self.train(was_training)
        return 1.0 / (NEAR * unit)

    def _warn_of_shape(self, height: int, width: int) -> None:
        """Say once what size would keep the shape of the images, if nobody has chosen one."""
        squeezed = (width / height) / (self.input_size[1] / self.input_size[0])
        if self._chosen_size or 1 / SHAPE_TOLERANCE < squeezed < SHAPE_TOLERANCE:
            return
        self._chosen_size = True
        better = self.rules.nearest(self.input_size[0], self.input_size[0] * width / height)
        log.warning(
            "Images of %dx%d are squeezed to %dx%d for the model; depth.height=%d depth.width=%d would keep the shape.",
            width, height, self.input_size[1], self.input_size[0], *better,
        )  # fmt: skip


def _patch(config: Any) -> int:
    """The side of the model's patches: its own or its backbone's; 1 where there are none."""
    for holder in (config, getattr(config, "backbone_config", None)):
        patch = getattr(holder, "patch_size", None)
        if patch:
            return int(patch if isinstance(patch, int) else patch[0])
    return 1


def _square(config: Any) -> bool:
    """Whether the model reads the shape of its patch grid off the root of their number, as DPT's own backbones do."""
    return config.model_type == "dpt" and (config.backbone_config is None or bool(config.is_hybrid))


def _stored_scale(folder: Path) -> float | None:
    path = folder / OWN
    if not path.is_file():
        return None
    return float(json.loads(path.read_text(encoding="utf-8"))["disparity_scale"])
