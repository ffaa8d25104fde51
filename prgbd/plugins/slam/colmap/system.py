"""``ColmapSLAM``: frames are collected, and COLMAP reconstructs them at the end."""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError, SlamError
from prgbd.core.option_ranges import Count, NotNegative, Range
from prgbd.core.slam import GeometricSLAM, Listener, TrackingResult, TrackingState
from prgbd.core.types import Frame, Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory
from prgbd.plugins.slam.colmap.completion import depth_scale, from_first_camera, interpolate, scaled
from prgbd.plugins.slam.colmap.location import Located, locate
from prgbd.plugins.slam.colmap.reconstruction import ColmapSettings, Model, image_name, reconstruct

INTRINSICS = ("given", "refine", "unknown")
MIN_IMAGES = 10
"""Of a recording that is too short for so many images at ``every``, more of its frames are taken."""

log = logging.getLogger("prgbd")


class ColmapSLAM(GeometricSLAM):
    """Offline structure from motion on every n-th frame; the others are located against its map by PnP.

    A frame that PnP does not find is interpolated between neighbours no farther apart than ``every`` frames and gets
    the state ``interpolated``; all others are lost. Images lie in a folder until the end, so memory does not grow with
    the length of the recording.

    Args:
        every: Every such frame, and the last, is given to COLMAP; of recordings with less than ten times as many
            frames, more are.
        intrinsics: ``given`` keeps the camera, ``refine`` starts from it, ``unknown`` estimates focal length and one
            radial distortion from the images.
        features: Most SIFT keypoints per image.
        overlap: Images that each is matched with: those 1, 2, 4, 8, ... further on.
        init_max_forward_motion: Largest part of forward motion in the first pair; COLMAP's own is 0.95, 1 allows all.
        init_min_tri_angle: Smallest angle of triangulation in the first pair, degrees; COLMAP's own is 16.
        min_model_size: Models with fewer images are dropped.
        threads: Threads for features and matches.
        folder: Where images and the database lie while it works; None takes the system's folder for temporary files.

    Raises:
        ConfigError: If an option cannot work.
    """

    modes: ClassVar[frozenset[str]] = frozenset({"mono", "rgbd"})

    def __init__(
        self,
        every: Count = 5,
        intrinsics: Literal["given", "refine", "unknown"] = "given",
        features: Count = 4096,
        overlap: Count = 10,
        init_max_forward_motion: NotNegative = 1.0,
        init_min_tri_angle: NotNegative = 4.0,
        min_model_size: Count = 3,
        threads: Annotated[int, Range(1, 1024)] = 2,
        folder: str | Path | None = None,
    ) -> None:
        if intrinsics not in INTRINSICS:
            raise ConfigError(f"slam.intrinsics={intrinsics} is unknown; choose {', '.join(INTRINSICS)}.")
        self.every, self.folder = every, folder
        self._options = {
            "intrinsics": intrinsics,
            "features": features,
            "overlap": overlap,
            "init_max_forward_motion": float(init_max_forward_motion),
            "init_min_tri_angle": float(init_min_tri_angle),
            "min_model_size": int(min_model_size),
            "threads": threads,
        }
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._listener: Listener | None = None

    def reset(
        self, camera: PinholeCamera, mode: str, *, baseline: float | None = None, fps: float = 30.0, seed: int = 0
    ) -> None:
        """See ``GeometricSLAM.reset``; baseline and frame rate are not used. The camera may have distortion."""
        if mode not in self.modes:
            raise ConfigError(f"colmap has no mode '{mode}'; use slam.mode=mono or slam.mode=rgbd.")
        self.close()
        if self.folder is not None:
            Path(self.folder).mkdir(parents=True, exist_ok=True)
        self._temporary = tempfile.TemporaryDirectory(prefix="prgbd-colmap-", dir=self.folder)
        self._path = Path(self._temporary.name)
        (self._path / "images").mkdir()
        self._camera, self._mode, self._seed = camera, mode, seed
        self._stamps: list[float] = []
        self._indices: list[int] = []
        self._last: Frame | None = None

    def listen(self, listener: Listener | None) -> None:
        """See ``GeometricSLAM.listen``: features, matches, mapping and the location of frames are told of."""
        self._listener = listener

    def track(self, frame: Frame) -> TrackingResult:
        """See ``GeometricSLAM.track``: the frame is written to a file."""
        position = len(self._stamps)
        chosen = position % self.every == 0
        path = self._path / "images" / image_name(position)
        if not cv2.imwrite(str(path), cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)):
            raise DataError(f"The image {path} could not be written; is the disk full?")
        if chosen or position < self.every * MIN_IMAGES:
            self._store_depth(frame, position)
        self._last = frame
        self._stamps.append(frame.timestamp)
        self._indices.append(frame.index)
        return TrackingResult(TrackingState.COLLECTED, None, 0, chosen, {"keyframes": position // self.every + 1})

    def finish(self) -> SlamResult:
        """See ``GeometricSLAM.finish``.

        Raises:
            SlamError: If COLMAP registers nothing, or the depth fixes no scale.
        """
        assert self._last is not None, "finish before the first frame"
        count = len(self._stamps)
        stride = min(self.every, max(1, count // MIN_IMAGES))
        chosen = sorted({*range(0, count, stride), count - 1})  # nothing locates frames far behind the last one
        self._store_depth(self._last, count - 1)
        settings = ColmapSettings(**self._options, seed=self._seed)  # type: ignore[arg-type]
        model = from_first_camera(reconstruct(self._path, chosen, self._camera, settings, self._tell))
        _say_what_is_left_out(model, len(chosen))
        depth = np.zeros(len(model.point), np.float32)
        scale = None
        if self._mode == "rgbd":
            depth = self._depth_at(model)
            scale = depth_scale(model, depth)
            if scale is None:
                raise SlamError(
                    "Too few of COLMAP's points have a measured depth to fix the scale; use slam.mode=mono."
                )
            model = scaled(model, scale)
        located = locate(model, self._grey, count, self._seed, self._tell)
        result = self._result(model, located, depth, {"given_images": len(chosen), "depth_scale": scale})
        self.close()
        return result

    def close(self) -> None:
        """Delete the images and the database."""
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None

    def _tell(self, what: str, done: int, total: int) -> None:
        if self._listener is not None:
            self._listener(what, done, total)

    def _store_depth(self, frame: Frame, position: int) -> None:
        if self._mode == "rgbd":
            assert frame.depth is not None  # the passive checks refuse such a frame before it comes here
            np.save(self._path / f"{position:08d}.npy", frame.depth)

    def _grey(self, position: int) -> NDArray[np.uint8]:
        image = cv2.imread(str(self._path / "images" / image_name(position)), cv2.IMREAD_GRAYSCALE)
        assert image is not None  # ``track`` has written it
        return np.asarray(image, np.uint8)

    def _depth_at(self, model: Model) -> NDArray[np.float32]:
        """Return the given depth at every observation, 0 where there is none."""
        depth = np.zeros(len(model.point), np.float32)
        for k, position in enumerate(model.frame_index):
            rows = np.flatnonzero(model.keyframe == k)
            given = np.load(self._path / f"{position:08d}.npy", mmap_mode="r")
            u, v = np.rint(model.raw_uv[rows]).astype(int).T
            depth[rows] = given[np.clip(v, 0, given.shape[0] - 1), np.clip(u, 0, given.shape[1] - 1)]
        return np.where(np.isfinite(depth), depth, 0).astype(np.float32)

    def _result(self, model: Model, located: Located, depth: NDArray[np.float32], stats: dict[str, Any]) -> SlamResult:
        stamps, indices = np.array(self._stamps), np.array(self._indices, np.int64)
        registered = model.frame_index
        found = np.concatenate([registered, located.frame_index])
        order = np.argsort(found)
        frames, wTc = interpolate(found[order], np.concatenate([model.wTc, located.wTc])[order], stamps, self.every)
        between = np.setdiff1d(frames, found)
        states = np.full(len(stamps), TrackingState.LOST.value, dtype=object)
        states[found], states[between] = TrackingState.OK.value, TrackingState.INTERPOLATED.value
        inliers = np.zeros(len(stamps), np.int32)
        inliers[registered] = np.bincount(model.keyframe, minlength=len(registered))
        inliers[located.frame_index] = located.inliers
        return SlamResult(
            camera=model.camera,
            mode=self._mode,
            frames=len(stamps),
            trajectory=Trajectory(indices[frames], stamps[frames], wTc),
            keyframes=Keyframes(
                indices[registered], stamps[registered], model.wTc, np.zeros(len(registered), np.int32)
            ),
            points=MapPoints(model.xyz, model.rgb),
            observations=Observations(model.keyframe, model.point, model.uv, depth),
            states=[str(state) for state in states],
            inliers=inliers,
            stats={
                **stats,
                "registered_images": len(registered),
                "model_sizes": model.sizes,
                "located_frames": len(located.frame_index),
                "interpolated_frames": indices[between].tolist(),
                "intrinsics": self._options["intrinsics"],
                "camera": model.camera.to_dict(),
            },
        )


def _say_what_is_left_out(model: Model, given: int) -> None:
    """Warn of images that are in no model, or in another than the largest."""
    if model.sizes[0] >= given:
        return
    log.warning("COLMAP registered %d of %d images.", model.sizes[0], given)
    if len(model.sizes) > 1:
        log.warning(
            "It found %d unconnected models of %s images; the largest is kept, frames of the others are lost.",
            len(model.sizes),
            ", ".join(map(str, model.sizes)),
        )
