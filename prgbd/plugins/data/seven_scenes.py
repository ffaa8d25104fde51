"""The 7-Scenes data set (Shotton et al., CVPR 2013): hand-held Kinect recordings of rooms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.naming import safe_name
from prgbd.io.text_tables import text_lines
from prgbd.plugins.data._camera import plausible
from prgbd.plugins.data._depth_files import DepthFormat
from prgbd.plugins.data._images import read_image
from prgbd.plugins.data._recording import Files, FileSequence, as_poses, choose, existing_root, or_unpack


class SevenScenesSequence(FileSequence):
    """One recording: ``root/SCENE/seq-XX/frame-XXXXXX.{color.png, depth.png, pose.txt}``.

    Depth is in millimetres, 0 and 65535 mean unknown. Depth and colour are not registered exactly in this data set.

    Args:
        root: The folder of the scenes, or of one scene.
        sequence: For example ``redkitchen/seq-01`` (``seq-01`` where ``root`` is a scene). None takes the only one.
        focal: Focal length in pixels. The colour camera fits 525; the 585 often shipped is the depth camera's.
        fps: Frames per second; the data set has no time stamps.
        depth_levels_per_metre: Grey levels in one metre of depth: 1000, as a level is a millimetre.
        depth_invalid: Grey levels that mean "unknown".
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If a file is absent or malformed.
    """

    def __init__(
        self,
        root: str | Path,
        sequence: str | None = None,
        focal: float = 525.0,
        fps: float = 30.0,
        depth_levels_per_metre: float = 1000.0,
        depth_invalid: tuple[float, ...] = (0, 65535),
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        if not (np.isfinite(focal) and focal > 0 and np.isfinite(fps) and fps > 0):
            raise ConfigError(f"The options focal={focal} and fps={fps} must be positive.")
        base = existing_root(root)
        chosen = choose(sequence, _names(base), base)
        folder = base / chosen
        images = _images(folder)
        height, width = read_image(images[0]).shape[:2]
        # The centre (320, 240) of 640x480 images, scaled for copies of another size.
        camera = plausible(width, height, (focal, focal, width / 2, height / 2), (), "The option focal")
        stems = [folder / path.name.split(".")[0] for path in images]
        depths = [path if (path := stem.with_name(f"{stem.name}.depth.png")).is_file() else None for stem in stems]
        poses = np.stack([_pose(stem.with_name(f"{stem.name}.pose.txt")) for stem in stems])
        numbers = np.array([int(stem.name.split("-")[1]) for stem in stems])
        files = Files(
            images,
            numbers / fps,
            depths if any(depths) else None,
            poses=poses if np.isfinite(poses).any() else None,
            depth_format=DepthFormat(depth_levels_per_metre, depth_invalid),
        )
        parts = chosen.split("/") if "/" in chosen else [base.resolve().name, chosen]
        name = "_".join(safe_name(part) for part in parts)
        super().__init__(name, camera, files, start, stop, step)

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the recordings in ``root``.

        Raises:
            DataError: If there are none.
        """
        return list(_names(existing_root(options["root"])))


def _names(base: Path) -> list[str]:
    found = [p for pattern in ("seq-*", "*/seq-*") for p in base.glob(pattern) if p.is_dir()]
    if not found:
        mend = or_unpack(base, "set data.root to the folder of the scenes")
        raise DataError(f"{base} has no folder SCENE/seq-XX; {mend}.")
    return sorted(p.relative_to(base).as_posix() for p in found)


def _images(folder: Path) -> list[Path]:
    found = {p.name.split(".")[0]: p for suffix in ("jpg", "png") for p in folder.glob(f"frame-*.color.{suffix}")}
    found = {stem: path for stem, path in found.items() if stem.split("-")[1].isdigit()}
    if not found:
        raise DataError(f"{folder} has no images frame-XXXXXX.color.png (or .jpg); check the option data.root.")
    return [found[stem] for stem in sorted(found)]


def _pose(path: Path) -> NDArray[np.float64]:
    """Return the pose (4, 4) of a frame, NaN where the file is absent or holds the data set's mark of a lost pose."""
    unknown = np.full((4, 4), np.nan)
    if not path.is_file():
        return unknown
    words = [word for _, line in text_lines(path, "pose") for word in line]
    try:
        # Lost poses were printed as -1.#IND by the recording program.
        values = np.array([float("nan") if "#" in word else float(word) for word in words])
    except ValueError:
        values = np.zeros(0)
    if values.size != 16:
        raise DataError(f"{path} is not a 4x4 matrix of numbers; copy the file anew.")
    if not np.isfinite(values).all():
        return unknown
    return as_poses(values[None, :12], path)[0]
