r"""Measure the depth network: pseudo-depth of a recording, and training steps, beside plain float32 PyTorch.

Examples:
    python benchmarks/depth.py
    python benchmarks/depth.py --compile --rounds 9
    python benchmarks/depth.py --device cuda --batch 12
    python benchmarks/depth.py --images FOLDER --weights WEIGHTS --size 320x256 --json depth.json

All variants run in one process and take turns, so that a busy machine is busy for all; a ratio is the median over the
rounds. Inference is measured twice: the network alone, on images in memory, and the whole pass over a recording, which
decodes, resizes, predicts, and (ours) writes the cache. A training step is forward, backward and Adam on triplets in
memory. Depth and loss are compared with the plain program's.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from depth_plain import PlainStep, predicted, prepared
from slam_measuring import forget_peak, peak_mib

import prgbd
from prgbd.core.computing import Computing, compiled, computes_bfloat16
from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import ConfigError, PrgbdError
from prgbd.loop.sensing import DepthSensor
from prgbd.training.optimizers import adam
from prgbd.training.pretraining import DepthPretraining
from prgbd.training.pretraining_data import Triplets
from prgbd.training.pretraining_settings import PretrainingSettings

LEARNING_RATE = 1e-5
KEYFRAMES = 1000


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x192", metavar="WxH", help="of the network's input (default 640x192)")
    parser.add_argument("--batch", type=int, default=4, metavar="N", help="triplets per training step (default 4)")
    parser.add_argument("--frames", type=int, default=24, metavar="N", help="frames per inference round (default 24)")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="turns of every variant (default 5)")
    parser.add_argument("--threads", type=int, default=0, metavar="N", help="of PyTorch; default: what it takes itself")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--weights", default="demo", help="of monodepth2 (default: demo)")
    parser.add_argument("--images", metavar="FOLDER", help="images of your own instead of a synthetic street")
    parser.add_argument("--only", choices=("inference", "training"), help="measure one of the two")
    parser.add_argument("--compile", action="store_true", help="torch.compile as well; compiling takes minutes")
    parser.add_argument("--json", metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    for name in ("batch", "frames", "rounds"):
        if getattr(chosen, name) < 1:
            raise ConfigError(f"--{name} is {getattr(chosen, name)}; give at least 1.")
    width, times, height = chosen.size.partition("x")
    if not (times and width.isdigit() and height.isdigit()):
        raise ConfigError(f"--size is '{chosen.size}'; write WIDTHxHEIGHT, as in 640x192.")
    chosen.width, chosen.height = int(width), int(height)
    if chosen.device == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda needs a CUDA device and PyTorch sees none; leave it out.")
    return chosen


@dataclass
class Variant:
    """One way to do the same work.

    Attributes:
        name: For the table.
        work: Makes what does one round when it is called without arguments; the clock runs only in that call, which
            returns depth maps or the loss.
        seconds: Wall time of every round.
        cpu: CPU time of the process in every round, seconds.
        peak: Peak memory, MiB: of the process, or of the GPU.
        results: Of every round.
    """

    name: str
    work: Callable[[int], Callable[[], Any]]
    seconds: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    peak: float = 0.0
    results: list[Any] = field(default_factory=list)


def measure(variants: list[Variant], rounds: int, device: torch.device) -> None:
    """Let the variants take turns; a first turn warms up and is not counted."""
    for turn in range(-1, rounds):
        for variant in variants:
            work = variant.work(turn)
            _restart_peak(device)
            wall, cpu = time.perf_counter(), time.process_time()
            result = work()
            if device.type == "cuda":
                torch.cuda.synchronize(device)
            if turn >= 0:
                variant.seconds.append(time.perf_counter() - wall)
                variant.cpu.append(time.process_time() - cpu)
                variant.peak = max(variant.peak, _peak(device))
                variant.results.append(result)


def _restart_peak(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    else:
        forget_peak()


def _peak(device: torch.device) -> float:
    return torch.cuda.max_memory_allocated(device) / 2**20 if device.type == "cuda" else peak_mib()


def half(device: torch.device) -> str:
    """The half precision that a device computes in; ``float32`` for none."""
    if computes_bfloat16(device):
        return "bfloat16"
    return "float16" if device.type == "cuda" else "float32"


def computings(chosen: argparse.Namespace) -> dict[str, Computing]:
    """Our ways to predict, by their names."""
    device = torch.device(chosen.device)
    ways = {"ours, exact": Computing(), f"ours, {half(device)}": Computing(half(device), channels_last=True)}
    if chosen.compile:
        ways[f"ours, {half(device)}, compiled"] = Computing(half(device), channels_last=True, compile=True)
    return ways


def network_alone(chosen: argparse.Namespace, network: DepthEstimator, sequence: Sequence) -> list[Variant]:
    """The network on images that lie in memory, in the batches that the sensor makes; the plain program takes one."""
    device = torch.device(chosen.device)
    network.eval()
    images = torch.cat([prepared(network, sequence, index) for index in range(len(sequence))])

    def ours(way: Computing) -> Callable[[int], Callable[[], Any]]:
        size = DepthSensor.automatic_batch_size(way, device)

        def work() -> Any:
            with network.finest_scale(), way.applied(network, device, print):
                batches = [network(way.arranged(batch)).depth[:, 0] for batch in images.split(size)]
            return torch.cat(batches).float().cpu().numpy()

        return lambda turn: work

    def plain() -> Any:
        with torch.no_grad():
            return torch.cat([network(image[None]).depth[:, 0] for image in images]).cpu().numpy()

    ways = computings(chosen)
    return [Variant("plain float32", lambda turn: plain), *(Variant(name, ours(way)) for name, way in ways.items())]


def inference(chosen: argparse.Namespace, network: DepthEstimator, sequence: Sequence, folder: Path) -> list[Variant]:
    """The plain pass and the sensor's."""

    def sensed(way: Computing) -> Callable[[int], Callable[[], Any]]:
        def make(turn: int) -> Callable[[], Any]:
            # Once per recording the sensor hashes the weights, a tenth of a second: not what is measured here.
            sensor = DepthSensor(network, sequence, folder / "cache", name="benchmark", computing=way)

            def work() -> Any:
                sensor.prepare()
                depth = 1 / np.load(sensor.path)
                sensor.forget()
                return depth

            return work

        return make

    plain = Variant("plain float32", lambda turn: lambda: np.stack(list(predicted(network, sequence))))
    return [plain, *(Variant(name, sensed(way)) for name, way in computings(chosen).items())]


def training(chosen: argparse.Namespace, network: DepthEstimator, sequence: Sequence) -> list[Variant]:
    """The plain step and ours, each with networks of its own and the same noise."""
    device = torch.device(chosen.device)
    images, K = triplets(network, sequence, chosen.batch, device)
    settings = PretrainingSettings(learning_rate=LEARNING_RATE)
    plain_network = copy.deepcopy(network)
    plain = PlainStep(plain_network, copy.deepcopy(network.pose_network()), LEARNING_RATE, settings.smoothness)

    def noise(turn: int) -> torch.Generator:
        return torch.Generator(device).manual_seed(turn + 1)

    def ours(precision: str, fast: bool, compile_it: bool = False) -> Callable[[int], Callable[[], float]]:
        options = PretrainingSettings(learning_rate=LEARNING_RATE, channels_last=fast)
        module = DepthPretraining(copy.deepcopy(network), copy.deepcopy(network.pose_network()), options).train()
        if fast:
            module.to(memory_format=torch.channels_last)
        optimizer = adam(module, module.parameters(), LEARNING_RATE)
        scaler = torch.amp.GradScaler(device.type, enabled=precision == "float16")

        def work(turn: int) -> float:
            enabled = precision != "float32"
            how = compiled(module.estimator, print) if compile_it else contextlib.nullcontext()
            with how, torch.autocast(device.type, getattr(torch, precision), enabled=enabled):
                loss = module.loss(Triplets(images, K), images, noise(turn))["total"]
            optimizer.zero_grad()
            scaler.scale(loss).backward()
            scaler.step(optimizer)
            scaler.update()
            return float(loss.detach())

        return lambda turn: lambda: work(turn)

    variants = [
        Variant("plain float32", lambda turn: lambda: plain.step(images, K, noise(turn))),
        Variant("ours, exact", ours("float32", False)),
        Variant(f"ours, {half(device)}", ours(half(device), True)),
    ]
    if chosen.compile:
        variants.append(Variant(f"ours, {half(device)}, compiled", ours(half(device), True, True)))
    return variants


def triplets(
    network: DepthEstimator, sequence: Sequence, batch: int, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor]:
    """Stack neighbouring frames, (B, 3, 3, H, W): target, earlier, later; and intrinsics, (B, 3, 3)."""
    targets = [1 + i % (len(sequence) - 2) for i in range(batch)]
    decoded = [network.preprocess(sequence.frame(i).image) for i in range(len(sequence))]
    images = torch.stack([torch.stack([decoded[t], decoded[t - 1], decoded[t + 1]]) for t in targets])
    height, width = network.input_size
    K = torch.from_numpy(sequence.camera.resized(width, height).K).float().expand(batch, 3, 3)
    return images.to(device), K.to(device)


def depth_difference(depth: Any, plain: Any) -> dict[str, float]:
    """Relative differences over all pixels, and of the largest depth, on which the virtual baseline hangs."""
    relative = np.abs(np.asarray(depth, np.float64) / plain - 1)
    return {
        "mean": float(relative.mean()),
        "p99": float(np.percentile(relative, 99)),
        "max": float(relative.max()),
        "largest_depth": float(np.max(depth) / np.max(plain) - 1),
    }


def figures(variants: list[Variant], images: int) -> list[dict[str, Any]]:
    """Return the figures of every variant; the first is the plain one."""
    plain = variants[0]
    found = []
    for variant in variants:
        row: dict[str, Any] = {
            "name": variant.name,
            "images_per_s": images / float(np.median(variant.seconds)),
            "ratio": float(np.median(np.divide(plain.seconds, variant.seconds))),
            "cpu_ratio": float(np.median(np.divide(plain.cpu, variant.cpu))),
            "peak_mib": variant.peak,
        }
        if np.ndim(variant.results[0]):
            row["depth_difference"] = depth_difference(variant.results[0], plain.results[0])
        else:
            row["loss"] = variant.results
            row["loss_difference"] = float(np.max(np.abs(np.divide(variant.results, plain.results) - 1)))
        found.append(row)
    return found


def print_table(title: str, rows: list[dict[str, Any]]) -> None:
    """Print one table."""
    is_depth = "depth_difference" in rows[0]
    difference = "depth differs by: mean   99 %    max  largest depth" if is_depth else "loss differs by at most"
    print(f"\n{title}")
    print(f"  {'':<26}{'images/s':>9}{'ratio':>8}{'by CPU time':>13}{'peak MiB':>10}   {difference}")
    for row in rows:
        start = f"  {row['name']:<26}{row['images_per_s']:9.2f}{row['ratio']:7.2f}x{row['cpu_ratio']:12.2f}x"
        if is_depth:
            d = row["depth_difference"]
            end = f"{d['mean']:22.2%}{d['p99']:7.2%}{d['max']:7.2%}{d['largest_depth']:+15.2%}"
        else:
            end = f"{row['loss_difference']:23.3%}"
        print(f"{start}{row['peak_mib']:10.0f}   {end}")


def print_loop(found: dict[str, list[dict[str, Any]]]) -> None:
    """Print what the best variant makes of one loop's share of the network."""
    parts_of_it = {name: rows for name, rows in found.items() if name != "network"}
    best = {name: max(row["images_per_s"] for row in rows) for name, rows in parts_of_it.items()}
    plain = {name: rows[0]["images_per_s"] for name, rows in parts_of_it.items()}
    print(f"\nThe network's part of one loop, per {KEYFRAMES} images and {KEYFRAMES} triplets, without SLAM:")
    for label, rates in (("plain float32", plain), ("ours, fastest", best)):
        parts = [f"{name} {KEYFRAMES / rate:.0f} s" for name, rate in rates.items()]
        print(f"  {label:<26}{', '.join(parts)}, together {sum(KEYFRAMES / rate for rate in rates.values()):.0f} s")


def make_images(folder: Path, frames: int) -> Path:
    """Write a synthetic street of KITTI's image size as PNG, so that decoding is part of the work."""
    street = prgbd.make_data("synthetic", frames=frames, width=1242, height=376)
    (folder / "street").mkdir()
    for index in range(frames):
        image = cv2.cvtColor(street.frame(index).image, cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(folder / "street" / f"{index:06}.png"), image)
    return folder / "street"


def run(chosen: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Measure and print."""
    if chosen.threads:
        torch.set_num_threads(chosen.threads)
    device = torch.device(chosen.device)
    network = prgbd.make_depth(
        "monodepth2", weights=chosen.weights, width=chosen.width, height=chosen.height, checks=False
    )
    network.to(device)
    pose = network.pose_network()
    assert pose is not None
    pose.to(device)
    root = Path(chosen.images) if chosen.images else make_images(folder, max(chosen.frames, 3))
    sequence = prgbd.make_data("images", root=root, fov=80, stop=max(chosen.frames, 3))
    where = torch.cuda.get_device_name(device) if device.type == "cuda" else f"{torch.get_num_threads()} CPU threads"
    print(f"monodepth2 {chosen.size}, {where}, PyTorch {torch.__version__}, median of {chosen.rounds} rounds in turns")
    found = {}
    if chosen.only != "training":
        variants = network_alone(chosen, network, sequence)
        measure(variants, chosen.rounds, device)
        found["network"] = figures(variants, len(sequence))
        print_table(f"The network alone, {len(sequence)} images", found["network"])
        variants = inference(chosen, network, sequence, folder)
        measure(variants, chosen.rounds, device)
        found["inference"] = figures(variants, len(sequence))
        print_table(f"Pseudo-depth of a recording of {len(sequence)} frames, from file to cache", found["inference"])
    if chosen.only != "inference":
        variants = training(chosen, network, sequence)
        measure(variants, chosen.rounds, device)
        found["training"] = figures(variants, chosen.batch)
        print_table(f"Training step on {chosen.batch} triplets", found["training"])
    print_loop(found)
    return {"size": chosen.size, "batch": chosen.batch, "device": where, "torch": torch.__version__, **found}


def main(arguments: list[str]) -> int:
    """Run and print."""
    try:
        chosen = parse(arguments)
        with tempfile.TemporaryDirectory() as folder:
            found = run(chosen, Path(folder))
        if chosen.json:
            Path(chosen.json).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    except PrgbdError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
