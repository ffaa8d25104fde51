"""Monodepth2 as a depth plug-in."""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from prgbd.core.depth import DepthEstimator, read_state_dict
from prgbd.core.errors import ConfigError, WeightsError
from prgbd.core.option_ranges import Positive, Seed, Side
from prgbd.core.sigma_head import SigmaHead
from prgbd.core.types import DepthPrediction
from prgbd.plugins.depth.monodepth2 import weights as files
from prgbd.plugins.depth.monodepth2.decoder import CHANNELS, SCALES, DepthDecoder, disparity_to_depth
from prgbd.plugins.depth.monodepth2.encoder import ResnetEncoder
from prgbd.plugins.depth.monodepth2.pose import PoseNetwork

DEFAULT_SIZE = (192, 640)


class Monodepth2(DepthEstimator):
    """Monodepth2 with ResNet-18 (Godard et al., ICCV 2019), depth up to scale.

    Args:
        weights: Folder of official-format files (``encoder.pth``, ``depth.pth``, optionally ``pose_encoder.pth`` and
            ``pose.pth``), ``demo`` for the weights that ship with prgbd, or None for a fresh network.
        height: Network input height, a multiple of 8; None takes the size in the weight files, or 192.
        width: Network input width, a multiple of 8; None takes the size in the weight files, or 640.
        min_depth: Nearest depth that the network can express.
        max_depth: Farthest depth that the network can express.
        imagenet_weights: File with torchvision's ResNet-18 weights to start a fresh network from.
        seed: Seed of a fresh network.
        uncertainty: Predict the standard deviation of log depth as well: null where ``weights`` bring the head for it
            (``uncertainty.pth``), true with a fresh one otherwise, false never. Depth is the same with and without.

    Raises:
        ConfigError: If a size or the depth range cannot work.
        WeightsError: If weights are missing or belong to another network.
    """

    def __init__(
        self,
        weights: str | Path | None = None,
        height: Side | None = None,
        width: Side | None = None,
        min_depth: Positive = 0.1,
        max_depth: Positive = 100.0,
        imagenet_weights: str | Path | None = None,
        seed: Seed = 0,
        uncertainty: bool | None = None,
    ) -> None:
        super().__init__()
        if not 0 < min_depth < max_depth:
            raise ConfigError(f"depth.min_depth={min_depth:g} must lie between 0 and depth.max_depth={max_depth:g}.")
        if weights is not None and imagenet_weights is not None:
            raise ConfigError("Give depth.weights or depth.imagenet_weights, not both: each sets the whole encoder.")
        self.depth_range = (float(min_depth), float(max_depth))
        self.seed = int(seed)
        self.imagenet_weights = None if imagenet_weights is None else Path(imagenet_weights)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            self.encoder = ResnetEncoder()
            self.depth = DepthDecoder()
        self._wants_uncertainty = uncertainty
        self.uncertainty = SigmaHead(CHANNELS[:SCALES]) if uncertainty else None
        self._keep_pose(None)
        self.input_size = DEFAULT_SIZE
        if self.imagenet_weights is not None:
            self._load_imagenet(self.encoder)
        if weights is not None:
            self.load_weights(Path(weights))
        self.input_size = (int(height or self.input_size[0]), int(width or self.input_size[1]))
        if min(self.input_size) < 64 or any(side % 8 for side in self.input_size):
            raise ConfigError(
                f"Monodepth2's input size {self.input_size[1]}x{self.input_size[0]} must be multiples of 8 from 64 "
                "up; change depth.width and depth.height."
            )

    def forward(self, images: Tensor) -> DepthPrediction:
        """Predict depth and disparity at 4 scales, or at the finest one within ``finest_scale``.

        The encoder halves the image five times. A side that is no multiple of 32 is continued by its mirror image,
        and that margin is cut off again at every scale, so that the camera of the image is the camera of the depth.

        Args:
            images: (B, 3, H, W) RGB in [0, 1]; H and W are multiples of 8.
        """
        disparities, maps = self._decoded(images, 1 if self.only_finest else SCALES)
        depths = tuple(disparity_to_depth(disparity, *self.depth_range) for disparity in disparities)
        return DepthPrediction(depths, disparities, None if self.uncertainty is None else self.uncertainty(maps))

    def sigma_head(self) -> SigmaHead | None:
        """See ``DepthEstimator.sigma_head``."""
        return self.uncertainty

    def sigma_features(self, images: Tensor) -> tuple[Tensor, ...]:
        """Return the maps of the decoder's last four steps."""
        return self._decoded(images, 1)[1]

    def _decoded(self, images: Tensor, scales: int) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """Return what ``DepthDecoder.decoded`` does, without the margin."""
        height, width = images.shape[-2:]
        top, bottom = _margin(height)
        left, right = _margin(width)
        if top or bottom or left or right:
            images = F.pad(images, (left, right, top, bottom), mode="reflect")

        def inner(scale: int, of: Tensor) -> Tensor:
            return of[..., top >> scale : (top + height) >> scale, left >> scale : (left + width) >> scale]

        disparities, maps = self.depth.decoded(self.encoder(images), scales)
        return tuple(inner(*item) for item in enumerate(disparities)), tuple(inner(*item) for item in enumerate(maps))

    def pose_network(self) -> nn.Module:
        """Return the pose network: the loaded one, or a fresh one; the same object at every call.

        It is no submodule of the depth network, so that refinement and ``state_dict`` leave it alone.
        """
        pose: PoseNetwork | None = self._pose
        if pose is None:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.seed + 1)
                pose = PoseNetwork()
            if self.imagenet_weights is not None:
                self._load_imagenet(pose.encoder)
            self._keep_pose(pose)
        return pose

    def save_weights(self, folder: Path, *, half: bool = False, pose: bool = True) -> None:
        """Write official-format files into ``folder``.

        Args:
            folder: Made if needed.
            half: Store float16, half the size.
            pose: Write the pose network as well, where there is one.
        """
        folder = Path(folder)
        height, width = self.input_size
        size = {"height": height, "width": width, "use_stereo": False}
        files.write_part(self.encoder, folder / files.ENCODER, half=half, extra=size)
        files.write_part(self.depth, folder / files.DEPTH, half=half)
        if self.uncertainty is not None:
            files.write_part(self.uncertainty, folder / files.UNCERTAINTY, half=False)
        if pose and self._pose is not None:
            files.write_part(self._pose.encoder, folder / files.POSE_ENCODER, half=half)
            files.write_part(self._pose.decoder, folder / files.POSE, half=half)

    def load_weights(self, folder: Path) -> None:
        """Read official-format files from ``folder`` (or a file in it, or ``demo``) and take over their input size.

        Raises:
            WeightsError: If a file is missing, unreadable or made for another network.
        """
        folder = files.find_folder(folder)
        state, size = files.read_encoder(folder)
        files.load_part(self.encoder, state, folder / files.ENCODER)
        files.load_part(self.depth, read_state_dict(folder / files.DEPTH), folder / files.DEPTH)
        self.input_size = size or self.input_size
        self._load_uncertainty(folder / files.UNCERTAINTY)
        if (folder / files.POSE_ENCODER).is_file() and (folder / files.POSE).is_file():
            pose = PoseNetwork()
            for part, name in ((pose.encoder, files.POSE_ENCODER), (pose.decoder, files.POSE)):
                files.load_part(part, read_state_dict(folder / name), folder / name)
            self._keep_pose(pose)

    def _load_uncertainty(self, path: Path) -> None:
        """Read the head of uncertainty; it knows nothing where the weights bring none."""
        if self._wants_uncertainty is False or not (self._wants_uncertainty or path.is_file()):
            self.uncertainty = None
            return
        self.uncertainty = self.uncertainty or SigmaHead(CHANNELS[:SCALES]).to(next(self.parameters()).device)
        if path.is_file():
            files.load_part(self.uncertainty, read_state_dict(path), path)
        else:
            self.uncertainty.reset()

    def _keep_pose(self, pose: PoseNetwork | None) -> None:
        self._pose: PoseNetwork | None
        object.__setattr__(self, "_pose", pose)  # not nn.Module's own, which would make it a submodule

    def _load_imagenet(self, encoder: ResnetEncoder) -> None:
        path = self.imagenet_weights
        assert path is not None
        if not path.is_file():
            raise WeightsError(f"There is no weight file {path}; check the option depth.imagenet_weights.")
        try:
            encoder.load_imagenet(read_state_dict(path))
        except (RuntimeError, TypeError, AttributeError) as error:
            raise WeightsError(
                f"{path} does not hold torchvision's ResNet-18 weights; check the option depth.imagenet_weights."
            ) from error


def _margin(side: int) -> tuple[int, int]:
    """Return what a multiple of 8 lacks to a multiple of 32, before and after it, both multiples of 8."""
    lacking = -side % 32
    before = lacking // 16 * 8
    return before, lacking - before
