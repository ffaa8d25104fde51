"""Camera files of other programs, in the words of prgbd's own: OpenCV, ROS, Kalibr, EuRoC and ORB-SLAM."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import yaml  # type: ignore[import-untyped]

from prgbd.core.errors import DataError
from prgbd.io.reading import read_text

log = logging.getLogger("prgbd")

MODELS = {
    "": "pinhole",
    "none": "pinhole",
    "pinhole": "pinhole",
    "opencv": "opencv",
    "plumb_bob": "opencv",
    "rational_polynomial": "opencv",
    "radtan": "opencv",
    "radial-tangential": "opencv",
    "fisheye": "fisheye",
    "equidistant": "fisheye",
    "equi": "fisheye",
    "kannalabrandt8": "fisheye",
}
"""What other programs call the models of lenses, in lower case."""

_MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "intrinsic_matrix", "K", "k", "M1", "mtx")
_DISTORTION = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distortion_coeffs",
    "distCoeffs",
    "dist_coeffs",
    "distortion",
    "D",
    "d",
    "D1",
    "dist",
)
_SIZE = (("width", "image_width", "image_Width"), ("height", "image_height", "image_Height"))


def read_camera_file(path: Path) -> Any:
    """Read a camera file of any known program.

    Args:
        path: A file of YAML or XML.

    Returns:
        What it holds; of another program's file, a mapping with prgbd's own entries.

    Raises:
        DataError: If it is absent or malformed, or has a camera or a distortion that is not known.
    """
    text = read_text(path, "the camera file, data.camera")
    values = _storage(text, path) if _is_storage(text) else _yaml(text, path)
    return translated(values, path) if isinstance(values, Mapping) else values


def _yaml(text: str, path: Path) -> Any:
    try:
        return yaml.safe_load(text)
    # A date that does not exist and nesting without end are no errors of YAML's own.
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is no readable YAML file; write 'camera:' with fx, fy, cx, cy.") from error


def _is_storage(text: str) -> bool:
    head = text.lstrip()[:500]
    return head.startswith("%YAML:1.0") or "<opencv_storage" in head or "!!opencv-matrix" in text


def _storage(text: str, path: Path) -> dict[str, Any]:
    """Read what OpenCV's ``FileStorage`` wrote."""
    head = "" if text.lstrip().startswith(("%YAML", "<")) else "%YAML:1.0\n---\n"
    try:
        storage = cv2.FileStorage(head + text.lstrip(), cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        root = storage.root()
        return {key: _plain(root.getNode(key)) for key in root.keys()}  # noqa: SIM118 (no mapping)
    except (cv2.error, SystemError, UnicodeError) as error:
        raise DataError(f"{path} is no readable file of OpenCV; write it anew with cv2.FileStorage.") from error


def _plain(node: cv2.FileNode) -> Any:
    if node.isMap():
        keys = node.keys()
        if {"rows", "cols", "data"} <= set(keys):
            return _plain(node.getNode("data"))
        return {key: _plain(node.getNode(key)) for key in keys}
    if node.isSeq():
        return [_plain(node.at(index)) for index in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isReal() or node.isInt() else None


def translated(values: Mapping[Any, Any], path: Path | str) -> Mapping[Any, Any]:
    """Return a file's content in prgbd's own words; what is in no other program's is returned as it is.

    Raises:
        DataError: If it has a camera or a distortion that is not known; ``path`` names it.
    """
    if isinstance(values.get("camera"), Mapping) or "fx" in values or "fov_degrees" in values:
        return values
    cameras = [key for key, value in values.items() if re.fullmatch(r"cam\d+", str(key)) and isinstance(value, Mapping)]
    if cameras:
        if len(cameras) > 1:
            log.warning("%s holds %d cameras; %s is taken.", path, len(cameras), cameras[0])
        values = values[cameras[0]]
    if "intrinsics" in values:
        return _of_kalibr(values, path)
    prefix = next((prefix for prefix in ("Camera.", "Camera1.") if f"{prefix}fx" in values), None)
    if prefix is not None:
        return _of_orb_slam(values, prefix, path)
    if any(key in values for key in _MATRIX):
        return _of_opencv(values, path)
    return values


def _of_kalibr(values: Mapping[Any, Any], path: Path | str) -> dict[str, Any]:
    """Translate a camera of Kalibr's camchain, or EuRoC's ``sensor.yaml``."""
    kind = values.get("camera_model", "pinhole")
    intrinsics = _numbers(values["intrinsics"])
    if kind != "pinhole" or len(intrinsics) != 4:
        raise DataError(f"{path} holds a camera of the model '{kind}'; calibrate with 'pinhole' (-radtan or -equi).")
    width, height = (*_numbers(values.get("resolution", ())), None, None)[:2]
    names = ("fx", "fy", "cx", "cy")
    return _camera(
        dict(zip(names, intrinsics, strict=True)), _first(values, _DISTORTION), (width, height), _model(values, path)
    )


def _of_orb_slam(values: Mapping[Any, Any], prefix: str, path: Path | str) -> dict[str, Any]:
    """Translate the settings of ORB-SLAM2 or 3."""
    kind = str(values.get("Camera.type", "PinHole"))
    if kind.lower() not in ("pinhole", "kannalabrandt8", "rectified"):
        raise DataError(f"{path} holds a camera of the type '{kind}'; PinHole and KannalaBrandt8 are known.")
    fisheye = kind.lower() == "kannalabrandt8"
    given = {name: values[prefix + name] for name in ("fx", "fy", "cx", "cy") if prefix + name in values}
    order = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    lens = [values.get(prefix + name, 0.0) for name in order]
    size = (values.get("Camera.width"), values.get("Camera.height"))
    return _camera(given, lens if fisheye or any(lens) else [], size, "fisheye" if fisheye else "opencv")


def _of_opencv(values: Mapping[Any, Any], path: Path | str) -> dict[str, Any]:
    """Translate the files of OpenCV's and ROS's calibration programs, and printed ``CameraInfo`` messages."""
    matrix = _numbers(_first(values, _MATRIX))
    if len(matrix) != 9:
        raise DataError(f"{path} has a camera matrix of {len(matrix)} numbers; it needs 9.")
    given = dict(zip(("fx", "cx", "fy", "cy"), (matrix[0], matrix[2], matrix[4], matrix[5]), strict=True))
    size = (_first(values, _SIZE[0]), _first(values, _SIZE[1]))
    return _camera(given, _first(values, _DISTORTION), size, _model(values, path))


def _model(values: Mapping[Any, Any], path: Path | str) -> str | None:
    """Return which of prgbd's models a file names, or None if it names none."""
    if values.get("fisheye_model") in (1, True):
        return "fisheye"
    named = values.get("distortion_model")
    if named is None:
        return None
    model = MODELS.get(str(named).lower())
    if model is None:
        raise DataError(f"{path} names the distortion model '{named}'; known are {', '.join(filter(None, MODELS))}.")
    return model


def _camera(given: dict[str, Any], lens: Any, size: tuple[Any, Any], model: str | None) -> dict[str, Any]:
    """Return prgbd's entries; a lens whose coefficients are all 0 is none."""
    entries = {**given, "distortion": _numbers(lens)}
    entries |= {key: value for key, value in zip(("width", "height"), size, strict=True) if value is not None}
    if not any(entries["distortion"]):
        entries["distortion"] = []
    return entries if model is None else {**entries, "model": model}


def _first(values: Mapping[Any, Any], names: tuple[str, ...]) -> Any:
    return next((values[name] for name in names if name in values), None)


def _numbers(value: Any) -> list[Any]:
    """Return the entries of a matrix or a list, row by row, however the file nests them."""
    if isinstance(value, Mapping):
        value = value.get("data")
    if isinstance(value, (list, tuple)):
        return [number for part in value for number in (_numbers(part) if isinstance(part, (list, tuple)) else [part])]
    return [] if value is None else [value]
