"""A SLAM result as COLMAP's text model, for COLMAP, pycolmap, nerfstudio and Gaussian splatting."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.multiview import reprojection_errors
from prgbd.io.files import atomic_path

if TYPE_CHECKING:
    from prgbd.core.types import Frame, PinholeCamera, SlamResult

# Of the images that the model speaks of: the number of the frame.
IMAGE_NAME = "{:06d}.png"
# prgbd counts pixels from the centre of the first one, COLMAP from its corner.
_TO_COLMAP = 0.5


def write_colmap(
    result: SlamResult, folder: Path | str, frame: Callable[[int], Frame] | None = None, image_name: str = IMAGE_NAME
) -> int:
    """Write ``sparse/0`` (``1``, ... for further unconnected maps) with ``cameras.txt, images.txt, points3D.txt``.

    Images are the keyframes, points those that a keyframe observes, with their mean reprojection error and track.
    COLMAP has no depth, so measured depth is left out; a map without scale stays without.

    Args:
        result: What SLAM found.
        folder: The project folder, as in ``colmap model_converter --input_path FOLDER/sparse/0``.
        frame: Returns the (undistorted) frame of a number, to write the keyframes' images to ``images/`` too.
        image_name: Format of the image names, given the frame number.

    Returns:
        Number of models.
    """
    folder = Path(folder)
    maps = np.unique(result.keyframes.map_id)
    for number, map_id in enumerate(maps):
        _write_model(
            result, np.flatnonzero(result.keyframes.map_id == map_id), folder / "sparse" / str(number), image_name
        )
    if frame is not None:
        for index in np.unique(result.keyframes.frame_index).tolist():
            _write_image(frame(int(index)).image, folder / "images" / image_name.format(int(index)))
    return len(maps)


def _write_model(result: SlamResult, keyframes: NDArray[np.int64], folder: Path, image_name: str) -> None:
    observations = result.observations
    rows = np.flatnonzero(np.isin(observations.keyframe, keyframes))
    rows = rows[np.argsort(observations.keyframe[rows], kind="stable")]
    keyframe, point = observations.keyframe[rows], observations.point[rows]
    uv = observations.uv[rows].astype(np.float64)
    # Where in its image's list of keypoints an observation stands.
    begin = np.searchsorted(keyframe, keyframe)
    place = np.arange(len(rows)) - begin
    _write_lines(folder / "cameras.txt", [_camera_line(result.camera)])
    _write_lines(folder / "images.txt", _image_lines(result, keyframes, keyframe, point, uv + _TO_COLMAP, image_name))
    errors = reprojection_errors(result.camera, result.keyframes, result.points, observations)[rows]
    errors = np.where(np.isfinite(errors), errors, 0.0)
    _write_lines(folder / "points3D.txt", _point_lines(result, keyframe, point, place, errors))


def _camera_line(camera: PinholeCamera) -> str:
    c = camera
    centre = f"{c.cx + _TO_COLMAP!r} {c.cy + _TO_COLMAP!r}"
    return f"1 PINHOLE {c.width} {c.height} {float(c.fx)!r} {float(c.fy)!r} {centre}"


def _image_lines(
    result: SlamResult,
    keyframes: NDArray[np.int64],
    keyframe: NDArray[np.int64],
    point: NDArray[np.int64],
    uv: NDArray[np.float64],
    image_name: str,
) -> list[str]:
    """Two lines per image: its pose (world to camera), then ``x y point`` of every keypoint."""
    from scipy.spatial.transform import Rotation

    lines = []
    for k in keyframes.tolist():
        cTw = np.linalg.inv(result.keyframes.wTc[k])
        x, y, z, w = Rotation.from_matrix(cTw[:3, :3]).as_quat(canonical=True).tolist()
        name = image_name.format(int(result.keyframes.frame_index[k]))
        lines.append(" ".join(map(repr, [w, x, y, z, *cTw[:3, 3].tolist()])).join((f"{k + 1} ", f" 1 {name}")))
        mine = slice(*np.searchsorted(keyframe, [k, k + 1]))
        columns = zip(uv[mine].tolist(), point[mine].tolist(), strict=True)
        lines.append(" ".join(f"{u:.4f} {v:.4f} {p + 1}" for (u, v), p in columns))
    return lines


def _point_lines(
    result: SlamResult,
    keyframe: NDArray[np.int64],
    point: NDArray[np.int64],
    place: NDArray[np.int64],
    errors: NDArray[np.float64],
) -> list[str]:
    """``id x y z r g b error`` and the track, (image, keypoint) of every observation."""
    order = np.argsort(point, kind="stable")
    ids, first = np.unique(point[order], return_index=True)
    tracks = np.split(order, first[1:]) if len(ids) else []  # np.split gives one empty part of nothing
    lines = []
    for p, track in zip(ids.tolist(), tracks, strict=True):
        xyz = " ".join(map(repr, result.points.xyz[p].tolist()))
        rgb = " ".join(map(str, result.points.rgb[p].tolist()))
        seen = " ".join(f"{k + 1} {i}" for k, i in zip(keyframe[track].tolist(), place[track].tolist(), strict=True))
        lines.append(f"{p + 1} {xyz} {rgb} {errors[track].mean():.4f} {seen}")
    return lines


def _write_lines(path: Path, lines: list[str]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("".join(f"{line}\n" for line in ["# Written by prgbd", *lines]), encoding="utf-8")


def _write_image(image: NDArray[Any], path: Path) -> None:
    import cv2

    with atomic_path(path) as temporary:
        cv2.imwrite(str(temporary), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
