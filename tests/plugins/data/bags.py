"""Small bags of ROS 1 and 2 written by tests."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.LATEST)
START = 1_700_000_000_000_000_000  # nanoseconds
Entry = tuple[str, int, Any]  # topic, time of recording in nanoseconds, message


class Ros:
    """Makes messages of a version: ``Ros(1).image(...)``."""

    def __init__(self, version: int) -> None:
        self.version, self.store = version, ROS1 if version == 1 else ROS2

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, nanoseconds: int, frame: str = "camera") -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        fields = {"seq": 0} if self.version == 1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **fields)

    def image(self, nanoseconds: int, pixels: np.ndarray, encoding: str, frame: str = "camera", pad: int = 0) -> Any:
        """An image message of pixels (H, W[, C]); rows are padded by some bytes."""
        height, width = pixels.shape[:2]
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
        rows = np.pad(rows, ((0, 0), (0, pad)))
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(nanoseconds, frame),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=int(pixels.dtype.byteorder == ">"),
            step=rows.shape[1],
            data=rows.ravel(),
        )

    def compressed(self, nanoseconds: int, data: bytes, form: str, frame: str = "camera") -> Any:
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(nanoseconds, frame),
            format=form,
            data=np.frombuffer(data, np.uint8),
        )

    def info(
        self,
        nanoseconds: int,
        size: tuple[int, int],
        K: Iterable[float],
        D: Iterable[float] = (),
        P: Iterable[float] = (0.0,) * 12,
        model: str = "plumb_bob",
        frame: str = "camera",
    ) -> Any:
        values = {"D": np.array([*D]), "K": np.array([*K]), "R": np.eye(3).ravel(), "P": np.array([*P])}
        if self.version == 2:
            values = {key.lower(): value for key, value in values.items()}
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(nanoseconds, frame),
            width=size[0],
            height=size[1],
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **{key: value.astype(float) for key, value in values.items()},
        )

    def write(self, path: Path, entries: Iterable[Entry], storage: str = "SQLITE3") -> Path:
        """Write messages into a bag and return its path."""
        first = self.version == 1
        path.parent.mkdir(parents=True, exist_ok=True)
        plugin = None if first else rosbag2.StoragePlugin[storage]
        writer = rosbag1.Writer(path) if first else rosbag2.Writer(path, version=9, storage_plugin=plugin)
        connections: dict[str, Any] = {}
        with writer:
            for topic, time, message in entries:
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                serialise = self.store.serialize_ros1 if first else self.store.serialize_cdr
                writer.write(connections[topic], time, serialise(message, kind))
        return path


def png(pixels: np.ndarray) -> bytes:
    """An image file of RGB or grey pixels."""
    done, data = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    assert done
    return data.tobytes()
