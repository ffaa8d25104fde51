"""``SyntheticSequence``: recordings of procedural worlds."""

from __future__ import annotations

import re
from collections import OrderedDict
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.option_ranges import NotNegative, Positive, Range, Seed, Side
from prgbd.core.types import Frame, PinholeCamera
from prgbd.plugins.data.synthetic.indoor import build_room
from prgbd.plugins.data.synthetic.render import draw_balls, draw_quads, plane_coefficients
from prgbd.plugins.data.synthetic.scene import Surfaces
from prgbd.plugins.data.synthetic.shade import shade
from prgbd.plugins.data.synthetic.street import build_street
from prgbd.plugins.data.synthetic.world import World, lit

SCENES = ("street", "indoor")
PATHS = ("loop", "reverse")
FIELD_OF_VIEW = {"street": 80.0, "indoor": 65.0}
LISTED_SEEDS = 8
REMEMBERED = 4


class SyntheticSequence(Sequence):
    """A procedural world seen by a moving camera, with true poses and depth; every frame follows from the seed.

    The street is a city block that a car drives around (about 250 m a lap, 0.4 to 0.8 m a frame); indoors a hand-held
    camera walks around a furnished room. A longer sequence goes further along the same path. Frames are rendered when
    asked for and only the last few are kept. The world itself (some 100 MB of textures) is built at the first frame.

    Args:
        sequence: ``SCENE-SEED``, for example ``street-0``; it takes precedence over ``scene`` and ``seed``.
        scene: ``street`` or ``indoor``.
        seed: Decides the layout, the textures and the colours.
        frames: Number of frames.
        width: Image width in pixels.
        height: Image height in pixels.
        fps: Frames per second; it sets the time stamps, not the distance between frames.
        fov: Horizontal field of view in degrees; None for 80 (street) or 65 (indoor).
        moving_objects: Number of moving objects.
        path: ``loop``, or ``reverse`` for the other way around.
        sensor_depth: Give the true depth as ``Frame.depth``, as an RGB-D camera would.
        depth_noise: Relative standard deviation of the sensor's depth.
        baseline: Metres to a right camera whose images come as ``Frame.right``; None for a single camera.
        noise: Standard deviation of the image noise, grey levels.
        exposure: Standard deviation of the brightness between frames, relative.

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If ``sequence`` names no world.
    """

    def __init__(
        self,
        sequence: str | None = None,
        scene: str = "street",
        seed: Seed = 0,
        frames: Annotated[int, Range(1, 10**6)] = 150,
        width: Side = 384,
        height: Side = 256,
        fps: Positive = 10.0,
        fov: float | None = None,
        moving_objects: Annotated[int, Range(0, 1000)] = 0,
        path: str = "loop",
        sensor_depth: bool = False,
        depth_noise: NotNegative = 0.0,
        baseline: Positive | None = None,
        noise: NotNegative = 1.5,
        exposure: NotNegative = 0.01,
    ) -> None:
        if sequence is not None:
            scene, seed = _parse(sequence)
        _check(scene, path)
        self.name = f"{scene}-{seed}"
        self.scene, self.seed = scene, int(seed)
        self.camera = PinholeCamera.from_fov(width, height, FIELD_OF_VIEW[scene] if fov is None else fov)
        self.timestamps = np.arange(frames, dtype=np.float64) / fps
        self.baseline = baseline
        self.moving_objects, self.reverse = int(moving_objects), path == "reverse"
        self.sensor_depth, self.depth_noise, self.noise, self.exposure = sensor_depth, depth_noise, noise, exposure
        self._built: World | None = None
        self._memo: OrderedDict[int, tuple[Frame, NDArray[np.float32]]] = OrderedDict()

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the first worlds of the scene; any other seed works as well."""
        scene = options.get("scene", "street")
        return [f"{scene}-{seed}" for seed in range(LISTED_SEEDS)]

    def frame(self, index: int) -> Frame:
        """Return a frame, with the sensor's depth and the right image if they were asked for.

        Raises:
            IndexError: If the index is out of range.
        """
        return self._rendered(index)[0]

    def depth(self, index: int) -> NDArray[np.float32]:
        """Return the true depth, (H, W) float32 metres, 0 in the sky; moving objects are included."""
        return self._rendered(index)[1]

    @property
    def poses(self) -> NDArray[np.float64]:
        """True poses ``wTc``, (N, 4, 4) float64; y of the world points down, the ground is at y = 0."""
        return self._world.poses

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what can be built again, so that data-loader workers start fast."""
        return {**self.__dict__, "_built": None, "_memo": OrderedDict()}

    @property
    def _world(self) -> World:
        if self._built is None:
            build = build_street if self.scene == "street" else build_room
            self._built = build(self.seed, len(self), self.moving_objects, self.reverse)
        return self._built

    def _rendered(self, index: int) -> tuple[Frame, NDArray[np.float32]]:
        if not 0 <= index < len(self):
            raise IndexError(f"Frame {index} of {self.name} is out of range; it has {len(self)} frames.")
        if index in self._memo:
            self._memo.move_to_end(index)
            return self._memo[index]
        rng = np.random.default_rng([self.seed, 5, index])
        pose = self._world.poses[index]
        gain = 1 + self.exposure * float(rng.standard_normal())
        clean, depth = self._render(index, pose)
        image = self._exposed(clean, gain, rng)
        right = None
        if self.baseline is not None:
            shifted = pose.copy()
            shifted[:3, 3] += self.baseline * pose[:3, 0]
            right = self._exposed(self._render(index, shifted)[0], gain, rng)
        measured = None
        if self.sensor_depth:
            factor = 1 + self.depth_noise * rng.standard_normal(depth.shape, dtype=np.float32)
            measured = np.maximum(depth * factor, 0) if self.depth_noise else depth.copy()
        self._memo[index] = Frame(index, float(self.timestamps[index]), image, measured, right), depth
        while len(self._memo) > REMEMBERED:
            self._memo.popitem(last=False)
        return self._memo[index]

    def _exposed(self, image: NDArray[np.float32], gain: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        noisy = gain * image
        if self.noise:
            noisy += self.noise * rng.standard_normal(image.shape, dtype=np.float32)
        return np.clip(noisy + 0.5, 0, 255).astype(np.uint8)

    def _render(self, index: int, wTc: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        stage, camera = self._world.stage, self.camera
        parts = [stage.surfaces]
        for mover in self._world.movers:
            wTo = mover.motion(index)
            parts.append(lit(mover.shape.moved(wTo[:3, :3], wTo[:3, 3]), stage.light))
        surfaces = Surfaces.joined(parts) if len(parts) > 1 else stage.surfaces
        K = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        cRw, origin = np.ascontiguousarray(wTc[:3, :3].T), np.ascontiguousarray(wTc[:3, 3])
        seen = np.full((2 * camera.height, 2 * camera.width), -1, np.int32)
        nearness = np.zeros(seen.shape, np.float32)
        planes = plane_coefficients(surfaces.quads, cRw, origin)
        draw_quads(surfaces.quads, planes, cRw, origin, K, seen, nearness)
        draw_balls(surfaces.balls, len(planes), cRw, origin, K, seen, nearness)
        image = np.zeros((camera.height, camera.width, 3), np.float32)
        depth = np.zeros((camera.height, camera.width), np.float32)
        shade(
            seen,
            nearness,
            planes,
            surfaces.quads,
            surfaces.quad_look,
            surfaces.balls,
            surfaces.ball_look,
            stage.atlas.arrays(),
            cRw,
            origin,
            K,
            stage.light,
            stage.sky,
            image,
            depth,
        )
        return image, depth


def _parse(sequence: str) -> tuple[str, int]:
    found = re.fullmatch(r"(\w+)-(\d+)", sequence)
    if found is None or found[1] not in SCENES:
        raise DataError(
            f"There is no synthetic sequence '{sequence}'; write SCENE-SEED with a scene of {', '.join(SCENES)}, "
            "for example 'street-0'."
        )
    return found[1], int(found[2])


def _check(scene: str, path: str) -> None:
    if scene not in SCENES:
        raise ConfigError(f"There is no synthetic scene '{scene}'; the option scene is one of {', '.join(SCENES)}.")
    if path not in PATHS:
        raise ConfigError(f"There is no synthetic path '{path}'; the option path must be one of {', '.join(PATHS)}.")
