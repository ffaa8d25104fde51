"""The interface of depth networks: ``DepthEstimator``."""

from __future__ import annotations

import contextlib
import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from collections.abc import Sequence as Many
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from prgbd.core.data import Sequence
from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import WeightsError
from prgbd.core.option_errors import shown
from prgbd.core.option_ranges import LARGEST_SIDE
from prgbd.core.sigma_head import SigmaHead
from prgbd.core.tensor_files import write_tensors
from prgbd.core.types import DepthPrediction, Frame
from prgbd.core.validation import check_image


class DepthEstimator(nn.Module, ABC):
    """A network that predicts depth from one image.

    A subclass sets the three declarations below and implements ``forward``; the rest has working defaults. The
    constructor takes ``weights`` (a folder or file, or None for a fresh network) besides its own options.

    Attributes:
        input_size: (height, width) of the images that ``forward`` works best on, pixels.
        depth_range: (nearest, farthest) depth that the network can express.
        depth_kind: What depth is: in metres, up to a scale, or with an inverse that lacks a shift as well. A subclass
            that says ``metric = True`` declares metres, too.
        only_finest: True within ``finest_scale``; ``forward`` may then return the finest depth alone.
    """

    input_size: tuple[int, int]
    depth_range: tuple[float, float]
    depth_kind: DepthKind = DepthKind.SCALE
    only_finest: bool = False
    weights_file: str = "model.pth"

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Take ``metric = True`` or ``False`` in the body of a subclass for the declaration that it is."""
        super().__init_subclass__(**kwargs)
        if isinstance(cls.__dict__.get("metric"), bool):
            cls.depth_kind = DepthKind.METRIC if cls.__dict__["metric"] else DepthKind.SCALE
            del cls.metric  # what is left is the property, which follows the declaration

    @property
    def metric(self) -> bool:
        """Whether depth is in metres; setting it declares that, or depth up to scale."""
        return self.depth_kind == DepthKind.METRIC

    @metric.setter
    def metric(self, value: bool) -> None:
        self.depth_kind = DepthKind.METRIC if value else DepthKind.SCALE

    @abstractmethod
    def forward(self, images: Tensor) -> DepthPrediction:
        """Predict depth.

        Args:
            images: (B, 3, H, W) float RGB in [0, 1].

        Returns:
            Depth maps finest first, each (B, 1, H_s, W_s), positive and differentiable; and, where the network knows
            it, the standard deviation of the logarithm of the finest one. Where ``depth_kind`` is ``affine_disparity``
            depth is 1 / disparity, the disparity brought to positive numbers by any scale and shift; one of 0, as of
            the sky, becomes the farthest depth.
        """

    @contextlib.contextmanager
    def finest_scale(self) -> Iterator[None]:
        """Ask for nothing but the finest depth within the block, as where depth is predicted and not trained.

        A network of several scales may look at ``only_finest`` in ``forward`` and leave out what the finest depth does
        not need; that depth must stay the same. One that does not look returns all of its scales as always.
        """
        before = self.only_finest
        self.only_finest = True
        try:
            yield
        finally:
            self.only_finest = before

    def preprocess(self, image: NDArray[np.uint8]) -> Tensor:
        """Resize an (H, W, 3) uint8 RGB image to ``input_size``: (3, h, w) float32 in [0, 1] on the CPU.

        Raises:
            ContractError: If the image is gray, or not of uint8.
        """
        check_image(image, "A depth network")
        height, width = self.input_size
        if image.shape[:2] != (height, width):
            image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        return torch.from_numpy(np.divide(image, np.float32(255), dtype=np.float32)).permute(2, 0, 1)

    def observe(self, sequence: Sequence, frame: Frame) -> Tensor:
        """Return what ``forward`` sees of a frame of a recording, (C, h, w) float32 on the CPU: its image, prepared.

        A plug-in that looks at more than the image, as a simulated sensor does, overrides it.
        """
        return self.preprocess(frame.image)

    def predict(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Predict depth at the image's own size, in evaluation mode and without gradients.

        The inverse depth is what is resized (Monodepth2, evaluation), so edges do not smear towards the far side.

        Args:
            image: (H, W, 3) uint8 RGB.

        Returns:
            (H, W) float32 depth, metres if ``metric``.
        """
        return _resized_depth(self._finest(image).depth, (image.shape[0], image.shape[1]))

    def predict_with_sigma(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Predict depth as ``predict`` does, and how wrong it may be.

        A network that brings a ``predict`` of its own and predicts deviations brings this as well.

        Args:
            image: (H, W, 3) uint8 RGB.

        Returns:
            (H, W) float32 depth, and (H, W) float32 standard deviation of its logarithm, None where the network does
            not predict it.
        """
        if type(self).predict is not DepthEstimator.predict:
            return self.predict(image), None
        prediction = self._finest(image)
        sigma = prediction.sigma
        size = (image.shape[0], image.shape[1])
        return _resized_depth(prediction.depth, size), None if sigma is None else resized_sigma(_array(sigma), size)

    def _finest(self, image: NDArray[np.uint8]) -> DepthPrediction:
        """Predict at the network's size, in evaluation mode and without gradients."""
        was_training = self.training
        self.eval()
        try:
            with torch.inference_mode(), self.finest_scale():
                device = next((p.device for p in self.parameters()), torch.device("cpu"))
                prediction: DepthPrediction = self(self.preprocess(image)[None].to(device))
                return prediction
        finally:
            self.train(was_training)

    def sigma_head(self) -> SigmaHead | None:
        """Return what predicts the standard deviation of log depth and can learn it from SLAM's points, or None."""
        return None

    def sigma_features(self, images: Tensor) -> Many[Tensor]:
        """Return the feature maps that ``sigma_head`` works on, finest first, for images as in ``forward``.

        Raises:
            NotImplementedError: If the network has a head and no such function.
        """
        raise NotImplementedError(f"{type(self).__name__} has no sigma_features.")

    def pose_network(self) -> nn.Module | None:
        """Return the pose network that belongs to this network's self-supervised pre-training, or None.

        It is called as ``pose(first, second)`` with two (B, 3, H, W) images in temporal order and returns
        ``secondTfirst``, (B, 4, 4): the transform that maps points of the first camera to the second.
        """
        return None

    def save_weights(self, folder: Path) -> None:
        """Write the weights into ``folder`` (made if needed) so that ``load_weights`` reads them."""
        folder.mkdir(parents=True, exist_ok=True)
        write_tensors(self.state_dict(), folder / self.weights_file)

    def load_weights(self, folder: Path) -> None:
        """Read weights from a folder that ``save_weights`` wrote, or from the file itself.

        Raises:
            WeightsError: If the file is missing, unreadable or made for another network.
        """
        folder = Path(folder)
        path = folder / self.weights_file if folder.is_dir() else folder
        load_matching(self, read_state_dict(path), path)


def resized_sigma(sigma: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """Bring a map of standard deviations, (h, w) float32, to the (height, width) of an image."""
    if sigma.shape == size:
        return sigma
    return np.asarray(cv2.resize(sigma, size[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def _array(maps: Tensor) -> NDArray[np.float32]:
    """The first of (B, 1, H, W) maps as (H, W) float32."""
    return np.asarray(maps[0, 0].float().cpu().numpy(), np.float32)


def _resized_depth(depths: Tensor, size: tuple[int, int]) -> NDArray[np.float32]:
    depth = _array(depths)
    if depth.shape == size:
        return depth
    inverse = cv2.resize(1.0 / depth, size[::-1], interpolation=cv2.INTER_LINEAR)
    return (1.0 / inverse).astype(np.float32)


def weights_fingerprint(module: nn.Module) -> str:
    """Return a short hash of all parameters and buffers, by name, shape, type and value."""
    digest = hashlib.sha256()
    for name, tensor in module.state_dict().items():
        digest.update(name.encode())
        if torch.is_tensor(tensor):
            digest.update(str((tuple(tensor.shape), tensor.dtype)).encode())
            digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:16]


def read_state_dict(path: Path) -> dict[str, Any]:
    """Read a weight file safely (``weights_only=True``) onto the CPU.

    Raises:
        WeightsError: If the file is missing or not a weight file.
    """
    try:
        present = path.is_file()
    except OSError:  # too long a name
        present = False
    if not present:
        raise WeightsError(f"There is no weight file {path}; check the option depth.weights.")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise WeightsError(
            f"{path} is not a readable PyTorch weight file ({type(error).__name__}); fetch it again."
        ) from error
    if not isinstance(state, Mapping):
        raise WeightsError(f"{path} holds a {type(state).__name__} instead of named weights; choose another file.")
    return dict(state)


def load_matching(module: nn.Module, state: Mapping[str, Any], path: Path) -> None:
    """Load ``state`` into ``module``, refusing anything that does not fit exactly, but for the precision.

    Raises:
        WeightsError: With the first names that are missing, unexpected, or of another shape, or with one that holds
            no weights at all.
    """
    own = module.state_dict()
    for name, value in state.items():
        if wrong := _unfit(value, own.get(name)):
            raise WeightsError(f"{path} has an entry {name} that {wrong}; choose other weights, or fetch them again.")
    missing = [k for k in own if k not in state]
    unexpected = [k for k in state if k not in own]
    shapes = [k for k in own if k in state and tuple(state[k].shape) != tuple(own[k].shape)]
    if missing or unexpected or shapes:
        parts = [
            f"{len(names)} {what} (e.g. {names[0]})"
            for what, names in (("missing", missing), ("unexpected", unexpected), ("of another shape", shapes))
            if names
        ]
        raise WeightsError(
            f"{path} holds the weights of another network than {type(module).__name__}: {', '.join(parts)} entries; "
            "choose the weights that belong to the depth plug-in."
        )
    module.load_state_dict(dict(state))


def stored_size(entries: Mapping[str, Any], path: Path) -> tuple[int, int] | None:
    """Return the (height, width) that a weight file was trained with, None if its entries do not say so.

    Raises:
        WeightsError: If they are no sizes.
    """
    if "height" not in entries or "width" not in entries:
        return None
    size = entries["height"], entries["width"]
    if not all(isinstance(side, int) and not isinstance(side, bool) and 0 < side <= LARGEST_SIDE for side in size):
        raise WeightsError(f"{path} says that its input size is {shown(size)}; fetch it again.")
    return size


def _unfit(value: Any, own: Any) -> str:
    """Say why an entry of a weight file cannot be a weight, "" if it can."""
    if not isinstance(value, torch.Tensor) or value.layout != torch.strided or value.is_quantized:
        return "is no plain tensor"
    if own is not None and (value.is_floating_point(), value.is_complex()) != (own.is_floating_point(), False):
        return f"holds {str(value.dtype).removeprefix('torch.')} in place of {str(own.dtype).removeprefix('torch.')}"
    if value.is_floating_point() and not bool(torch.isfinite(value).all()):
        return "holds NaN or infinity"
    return ""
