"""Small models of several architectures with random weights, written as Transformers writes them."""

from __future__ import annotations

import json
from pathlib import Path

import torch


def depth_anything(folder: Path, kind: str = "relative", processor: bool = True) -> Path:
    from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, Dinov2Config

    backbone = Dinov2Config(
        image_size=56, patch_size=14, hidden_size=32, num_hidden_layers=4, num_attention_heads=2, intermediate_size=64,
        out_indices=[1, 2, 3, 4], reshape_hidden_states=False, apply_layernorm=True,
    )  # fmt: skip
    config = DepthAnythingConfig(
        backbone_config=backbone, reassemble_hidden_size=32, neck_hidden_sizes=[8, 8, 16, 16], fusion_hidden_size=16,
        head_hidden_size=8, depth_estimation_type=kind, max_depth=20 if kind == "metric" else 1,
    )  # fmt: skip
    return _write(DepthAnythingForDepthEstimation, config, folder, processor and {
        "image_mean": [0.485, 0.456, 0.406], "image_std": [0.229, 0.224, 0.225], "do_normalize": True, "resample": 3,
        "size": {"height": 70, "width": 70}, "ensure_multiple_of": 14, "keep_aspect_ratio": True,
        "image_processor_type": "DPTImageProcessor",
    })  # fmt: skip


def dpt(folder: Path) -> Path:
    from transformers import DPTConfig, DPTForDepthEstimation

    config = DPTConfig(
        image_size=64, patch_size=16, hidden_size=32, num_hidden_layers=4, num_attention_heads=2, intermediate_size=64,
        backbone_out_indices=[0, 1, 2, 3], neck_hidden_sizes=[8, 8, 16, 16], fusion_hidden_size=16, is_hybrid=False,
    )  # fmt: skip
    return _write(DPTForDepthEstimation, config, folder, {
        "image_mean": [0.5] * 3, "image_std": [0.5] * 3, "do_normalize": True, "size": {"height": 64, "width": 64},
        "resample": 3, "image_processor_type": "DPTImageProcessor",
    })  # fmt: skip


def glpn(folder: Path) -> Path:
    from transformers import GLPNConfig, GLPNForDepthEstimation

    config = GLPNConfig(
        hidden_sizes=[8, 16, 24, 32], depths=[1, 1, 1, 1], num_attention_heads=[1, 1, 2, 2], decoder_hidden_size=8,
        drop_path_rate=0.0, max_depth=80,
    )  # fmt: skip
    return _write(GLPNForDepthEstimation, config, folder, {
        "do_resize": True, "do_rescale": True, "size_divisor": 32, "resample": 2,
        "image_processor_type": "GLPNImageProcessor",
    })  # fmt: skip


def zoedepth(folder: Path) -> Path:
    from transformers import BeitConfig, ZoeDepthConfig, ZoeDepthForDepthEstimation

    backbone = BeitConfig(
        image_size=64, patch_size=16, hidden_size=32, num_hidden_layers=4, num_attention_heads=2, intermediate_size=64,
        out_indices=[1, 2, 3, 4], reshape_hidden_states=False, use_relative_position_bias=True,
    )  # fmt: skip
    config = ZoeDepthConfig(
        backbone_config=backbone, neck_hidden_sizes=[8, 8, 16, 16], fusion_hidden_size=16, bottleneck_features=16,
        num_relative_features=8, num_attractors=[4, 2, 2, 1], bin_embedding_dim=8,
        bin_configurations=[{"n_bins": 8, "min_depth": 0.001, "max_depth": 10.0, "name": "nyu"}],
    )  # fmt: skip
    return _write(ZoeDepthForDepthEstimation, config, folder, {
        "image_mean": [0.5] * 3, "image_std": [0.5] * 3, "do_normalize": True, "size": {"height": 64, "width": 96},
        "ensure_multiple_of": 32, "keep_aspect_ratio": True, "resample": 2,
        "image_processor_type": "ZoeDepthImageProcessor",
    })  # fmt: skip


def _write(cls, config, folder: Path, processor) -> Path:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        model = cls(config)
        for name, parameter in model.named_parameters():
            # The output of a fresh head may be negative everywhere, and then a ReLU makes it zero without a gradient.
            if name.startswith("head.") and parameter.ndim == 1:
                torch.nn.init.constant_(parameter, 0.2)
    model.save_pretrained(folder)
    if processor:
        (folder / "preprocessor_config.json").write_text(json.dumps(processor))
    return folder


MODELS = {"depth_anything": depth_anything, "dpt": dpt, "glpn": glpn, "zoedepth": zoedepth}
