"""What SLAM sees and finds, for the viewer of rerun (https://rerun.io)."""

from __future__ import annotations

import logging
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError
from prgbd.core.slam import GeometricSLAM, SlamView, TrackingResult
from prgbd.core.types import Frame, PinholeCamera, SlamResult, resize_pixels

log = logging.getLogger(__name__)

# Recordings stay small: images no wider than this, the map again only when it has changed by that much.
_IMAGE_WIDTH = 640
_DEPTH_WIDTH = 320
_JPEG_QUALITY = 80
_MAP_CHANGE = 0.1
_MAP_FRAMES = 100
_STRIP_FRAMES = 10
_ORANGE = (255, 128, 0)
_BLUE = (60, 130, 220)
_GREEN = (80, 220, 100)


class RerunViewer:
    """Logs images with keypoints, depth, camera, trajectory, keyframes and map points over the frame number.

    Args:
        name: Of the recording.
        camera: The camera of the frames.
        path: The ``.rrd`` file to write; None opens the live viewer.

    Raises:
        ConfigError: If the live viewer cannot be opened.
    """

    def __init__(self, name: str, camera: PinholeCamera, path: Path | None) -> None:
        self._camera = camera
        self._small, self._smaller = _narrowed(camera, _IMAGE_WIDTH), _narrowed(camera, _DEPTH_WIDTH)
        self._positions: list[NDArray[np.float64]] = []
        self._keyframes: list[NDArray[np.float64]] = []
        self._points, self._mapped_at = 0, -_MAP_FRAMES
        self._state = ""
        self._stream = rr.RecordingStream("prgbd")
        self._stream.set_log_time_enabled(False)
        if path is None:
            try:
                self._stream.spawn(default_blueprint=_blueprint())
            except Exception as error:  # rerun raises plain RuntimeErrors
                raise ConfigError(f"The viewer of rerun could not be opened ({error}); use viz=rerun.") from error
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(str(path), default_blueprint=_blueprint())
        self._stream.send_recording_name(name)
        self._stream.log("world", rr.ViewCoordinates.RDF, static=True)
        self._stream.log("world/camera/image", _pinhole(self._small), static=True)
        self._stream.log("world/camera/depth", _pinhole(self._smaller), static=True)

    def tracked(self, frame: Frame, tracked: TrackingResult, system: GeometricSLAM) -> None:
        """See ``SlamViewer.tracked``."""
        log = self._stream.log
        self._stream.set_time("frame", sequence=frame.index)
        self._stream.set_time("time", duration=frame.timestamp)
        log("world/camera/image", rr.Image(_resized(frame.image, self._small)).compress(jpeg_quality=_JPEG_QUALITY))
        if frame.depth is not None:
            log("world/camera/depth", _depth_image(_resized(frame.depth, self._smaller)))
        self._log_state(frame.index, tracked)
        view = system.view()
        keypoints = np.zeros((0, 2)) if view is None else self._on_small(view.keypoints)
        log("world/camera/image/keypoints", rr.Points2D(keypoints, colors=_GREEN, radii=2.0))
        if tracked.wTc is not None:
            self._log_pose(tracked)
        if tracked.is_keyframe:
            self._log_map(frame.index, view)

    def finished(self, result: SlamResult) -> None:
        """See ``SlamViewer.finished``: the corrected trajectory, the final keyframes and the final map."""
        self._stream.set_time("frame", sequence=result.frames)
        self._log_points(result.points.xyz, result.points.rgb)
        self._log_centres(result.keyframes.wTc[:, :3, 3])
        positions = result.trajectory.positions
        # A gap in the frames is a gap in the line.
        parts = np.split(positions, np.flatnonzero(np.diff(result.trajectory.frame_index) > 1) + 1)
        self._stream.log("world/trajectory", rr.LineStrips3D([p for p in parts if len(p)], colors=_BLUE))
        message = f"{result.tracked_frames} of {result.frames} frames have a pose"
        self._stream.log("state", rr.TextLog(f"{message}; the map has {len(result.points)} points."))

    def __enter__(self) -> RerunViewer:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None
    ) -> None:
        try:
            self._stream.flush()
        except RuntimeError as error:  # the window was closed; that must not cost the result
            log.warning("Not everything reached the viewer of rerun (%s).", error)
        self._stream.disconnect()

    def _log_state(self, index: int, tracked: TrackingResult) -> None:
        self._stream.log("plots/inliers", rr.Scalars(float(tracked.inliers)))
        if tracked.state.value != self._state:
            self._state = tracked.state.value
            level = rr.TextLogLevel.WARN if self._state == "lost" else rr.TextLogLevel.INFO
            self._stream.log("state", rr.TextLog(f"Frame {index}: {self._state}", level=level))

    def _log_pose(self, tracked: TrackingResult) -> None:
        wTc = tracked.wTc
        assert wTc is not None
        self._stream.log("world/camera", rr.Transform3D(translation=wTc[:3, 3], mat3x3=wTc[:3, :3]))
        self._positions.append(wTc[:3, 3])
        if len(self._positions) % _STRIP_FRAMES == 0:
            self._stream.log("world/trajectory", rr.LineStrips3D([np.stack(self._positions)], colors=_BLUE))
        if tracked.is_keyframe:
            self._keyframes.append(wTc)

    def _log_map(self, index: int, view: SlamView | None) -> None:
        if view is None:
            self._log_centres(np.stack(self._keyframes)[:, :3, 3] if self._keyframes else np.zeros((0, 3)))
            return
        self._log_centres(view.keyframes[:, :3, 3])
        changed = abs(len(view.points) - self._points) > _MAP_CHANGE * self._points
        if changed or index - self._mapped_at >= _MAP_FRAMES:
            self._points, self._mapped_at = len(view.points), index
            self._log_points(view.points, view.rgb)

    def _log_points(self, xyz: NDArray[np.float64], rgb: NDArray[np.uint8]) -> None:
        self._stream.log("world/map", rr.Points3D(xyz, colors=rgb, radii=rr.Radius.ui_points(1.5)))

    def _log_centres(self, centres: NDArray[np.float64]) -> None:
        self._stream.log("world/keyframes", rr.Points3D(centres, colors=_ORANGE, radii=rr.Radius.ui_points(4.0)))

    def _on_small(self, uv: NDArray[np.float32]) -> NDArray[np.float64]:
        """Pixels of the full image on the smaller one."""
        scale = np.array([self._small.width / self._camera.width, self._small.height / self._camera.height])
        return np.asarray(resize_pixels(uv, scale))


def _narrowed(camera: PinholeCamera, width: int) -> PinholeCamera:
    scale = min(1.0, width / camera.width)
    return camera.resized(round(camera.width * scale), round(camera.height * scale))


def _pinhole(camera: PinholeCamera) -> rr.Pinhole:
    axes = rr.ViewCoordinates.RDF
    return rr.Pinhole(image_from_camera=camera.K, width=camera.width, height=camera.height, camera_xyz=axes)


def _resized(image: NDArray[Any], camera: PinholeCamera) -> NDArray[Any]:
    # Between two depths lies no surface, so depth is not interpolated.
    how = cv2.INTER_AREA if image.ndim == 3 else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=how))


def _depth_image(depth: NDArray[np.float32]) -> rr.EncodedDepthImage:
    """Depth as a PNG of 16 bits that spans its own range."""
    finite = np.where(np.isfinite(depth) & (depth > 0), depth, 0.0)
    units = 60000.0 / max(float(finite.max()), 1e-6)
    ok, png = cv2.imencode(".png", np.rint(finite * units).astype(np.uint16))
    assert ok
    return rr.EncodedDepthImage(blob=png.tobytes(), media_type="image/png", meter=units)


def _blueprint() -> rrb.Blueprint:
    """Show the map large, image, depth and inliers beside it."""
    column = rrb.Vertical(
        rrb.Spatial2DView(name="Image", origin="world/camera/image"),
        rrb.Spatial2DView(name="Depth", origin="world/camera/depth"),
        rrb.TimeSeriesView(name="Inliers", origin="plots"),
        rrb.TextLogView(name="State", origin="state"),
    )
    return rrb.Blueprint(rrb.Horizontal(rrb.Spatial3DView(name="Map", origin="world"), column, column_shares=[3, 2]))
