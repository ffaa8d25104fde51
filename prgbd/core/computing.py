"""How a network is computed: its precision, its memory layout, and whether it is compiled."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from prgbd.core.options import check_types

if TYPE_CHECKING:
    import torch
    from torch import Tensor, nn


@dataclass(frozen=True)
class Computing:
    """How a network predicts; the defaults are exact everywhere.

    Half precision is autocast's: convolutions and matrix products take it, the weights stay as they are. Whatever the
    network turns into depth at its end should be float32, for bfloat16 has 8 binary digits: compute the last layer
    under ``torch.autocast(device, enabled=False)``, as the networks of prgbd do.

    Attributes:
        precision: ``float32``, ``bfloat16``, ``float16``, or ``auto``: bfloat16 where the processor computes in it
            (AVX-512 BF16 or AMX; a GPU from Ampere on), float32 elsewhere. The same on one machine every time.
        channels_last: Keep images and weights with the channels innermost; convolutions are mostly faster so.
        compile: Compile the network with ``torch.compile`` at its first use, which takes about a minute.

    Raises:
        ConfigError: If the precision is unknown.
    """

    precision: Literal["auto", "float32", "bfloat16", "float16"] = "float32"
    channels_last: bool = False
    compile: bool = False

    def __post_init__(self) -> None:
        check_types(self, "sensing")

    def dtype(self, device: torch.device) -> torch.dtype:
        """Return the precision on a device."""
        import torch

        if self.precision != "auto":
            dtype: torch.dtype = getattr(torch, self.precision)
            return dtype
        return torch.bfloat16 if computes_bfloat16(device) else torch.float32

    def description(self, device: torch.device) -> list[str]:
        """Return what sets the results apart from those of the defaults, for the names of caches."""
        import torch

        dtype = self.dtype(device)
        found = [] if dtype == torch.float32 else [str(dtype)]
        return found + [name for name in ("channels_last", "compile") if getattr(self, name)]

    def arranged(self, images: Tensor) -> Tensor:
        """Return images (B, 3, H, W) in the chosen memory layout."""
        import torch

        return images.contiguous(memory_format=torch.channels_last) if self.channels_last else images

    def stacked(self, images: Sequence[Tensor]) -> Tensor:
        """Stack images (3, H, W) to a batch in the chosen memory layout."""
        import torch

        if not self.channels_last:
            return torch.stack(list(images))
        # Images that are decoded have their channels innermost already: no element changes its place.
        return torch.stack([image.permute(1, 2, 0) for image in images]).permute(0, 3, 1, 2)

    @contextlib.contextmanager
    def applied(self, network: nn.Module, device: torch.device, say: Callable[[str], None]) -> Iterator[None]:
        """Predict in this way within the block, without gradients.

        Args:
            network: Is called as always, ``network(images)``, with images that ``arranged`` or ``stacked`` returned.
            device: Where the network lies.
            say: Takes a sentence if the network cannot be compiled.
        """
        import torch

        dtype = self.dtype(device)
        if dtype == torch.float32:
            modes: list[contextlib.AbstractContextManager[Any]] = [torch.inference_mode()]
        else:
            # Autocast keeps the weights that it has converted until its block ends, but not in inference mode.
            modes = [torch.no_grad(), torch.autocast(device.type, dtype)]
        with contextlib.ExitStack() as stack:
            if self.channels_last:
                stack.enter_context(_weights_channels_last(network))
            for mode in modes:
                stack.enter_context(mode)
            if self.compile:
                stack.enter_context(compiled(network, say))
            yield


@contextlib.contextmanager
def _weights_channels_last(network: nn.Module) -> Iterator[None]:
    """Keep convolution weights with the channels innermost within the block: else every pass copies them so."""
    import torch

    weights = [p for p in network.parameters() if p.dim() == 4]
    before = [p.data for p in weights]
    try:
        for weight in weights:
            weight.data = weight.data.contiguous(memory_format=torch.channels_last)
        yield
    finally:
        for weight, data in zip(weights, before, strict=True):
            weight.data = data


def computes_bfloat16(device: torch.device) -> bool:
    """Say whether a device computes in bfloat16 rather than imitating it."""
    import torch

    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if device.type == "cpu":
        # Both are private names of PyTorch; a version without them computes in float32.
        known = (getattr(torch.cpu, f"_is_{name}_supported", bool) for name in ("avx512_bf16", "amx_tile"))
        return any(bool(is_supported()) for is_supported in known)
    return False


@contextlib.contextmanager
def compiled(network: nn.Module, say: Callable[[str], None] = warnings.warn) -> Iterator[None]:
    """Let ``torch.compile`` compute a network within the block; hooks on it stay.

    Where nothing can be compiled, most often because no C++ compiler is installed, the network is computed as always.

    Args:
        network: Its ``forward`` is replaced in the block.
        say: Takes a sentence if it cannot be compiled.
    """
    import torch

    replaced = vars(network).get("forward")
    plain = network.forward
    fast = torch.compile(plain, dynamic=False)
    given_up = False

    def forward(*args: Any, **kwargs: Any) -> Any:
        nonlocal given_up
        if given_up:
            return plain(*args, **kwargs)
        try:
            return fast(*args, **kwargs)
        except Exception as error:
            result = plain(*args, **kwargs)  # a network that fails in itself says so here
            given_up = True
            say(
                f"{type(network).__name__} cannot be compiled ({type(error).__name__}) and is computed as it is; "
                "install a C++ compiler (g++), or leave out the option compile."
            )
            return result

    network.forward = forward
    try:
        yield
    finally:
        del network.forward
        if replaced is not None:
            network.forward = replaced
