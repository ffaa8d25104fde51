"""Bags of ROS 1 and ROS 2 as recordings; no ROS is needed."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import DataError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.core.undistortion import Undistorter
from prgbd.io.naming import safe_name
from prgbd.io.reading import require_file, visible
from prgbd.plugins.data._bag import METADATA, SUFFIXES, Bag, Messages
from prgbd.plugins.data._bag_messages import camera_values, depth_of, image_of
from prgbd.plugins.data._bag_topics import Topics, choose_topics
from prgbd.plugins.data._camera import camera_from_values, known_or_estimated
from prgbd.plugins.data._depth_files import DepthFormat, DepthReader
from prgbd.plugins.data._images import levels_over
from prgbd.plugins.data._recording import VIDEO_SUFFIXES, check_index, choose, frame_range, or_unpack
from prgbd.plugins.data._rgbd_layout import partners_of_images, warn_if_few

log = logging.getLogger("prgbd")


class RosbagSequence(Sequence):
    """The images of one topic of a bag, with the depth of another one where it belongs to the same camera.

    Images are ``sensor_msgs/Image`` (grey, colour or Bayer) or ``CompressedImage``, and times are those of their
    headers. Depth is ``16UC1`` (millimetres), raw or compressed, or ``32FC1`` (metres), the nearest within 0.02 s, each
    serving once. The bag is read once to find the times; after that a frame is read when it is asked for.

    Args:
        root: A bag (``.bag``, ``.mcap``, ``.db3``, or the folder of a ROS 2 bag), or a folder of bags.
        sequence: Name of the bag within the folder; None for the only one.
        image: Topic of the images; None takes the only one.
        depth: Topic of the depth images; None takes that of the same frame of coordinates, if there is one.
        info: Topic of the ``CameraInfo``; None takes the one beside the images, or of their frame of coordinates.
        camera: A YAML file (``camera: {width, height, fx, fy, cx, cy, distortion}`` or ``fov_degrees``) or its content,
            instead of the bag's own; where neither tells, ``NAME.camera.yaml`` beside the bag does, or COLMAP
            estimates it (extra ``colmap``).
        fov: Horizontal field of view in degrees, instead of ``camera``.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If the bag is absent, truncated or damaged, or does not tell which topics to take.
    """

    def __init__(
        self,
        root: str | Path,
        sequence: str | None = None,
        image: str | None = None,
        depth: str | None = None,
        info: str | None = None,
        camera: str | Path | Mapping[str, Any] | None = None,
        fov: float | None = None,
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        path = _find(Path(root).expanduser(), sequence)
        self.name = safe_name(path.name if path.is_dir() else path.stem)
        bag = Bag(path)
        topics = choose_topics(bag, image, depth, info)
        self._images = Messages(bag, topics.image)
        self._chosen = np.array(frame_range(len(self._images), start, stop, step, self.name))
        self.timestamps = self._images.stamps[self._chosen] / 1e9
        self._depths, self._partners = self._depth_messages(bag, topics)
        pinhole = self._camera(bag, topics, camera, fov)
        self.camera = pinhole.undistorted()
        self._undistorter = Undistorter(pinhole)
        self._levels, understood = levels_over(self._picture, len(self._images))
        self._depth_reader = DepthReader(self.name, (pinhole.width, pinhole.height), DepthFormat())
        self.remarks = tuple(filter(None, (*topics.remarks, *self._remarks(), understood)))

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the bags of the folder ``root``, or ``[None]`` for a single one.

        Raises:
            DataError: If there are none.
        """
        root = Path(options["root"]).expanduser()
        return list(_bags(root)) if root.is_dir() and not _is_bag(root) else [None]

    def frame(self, index: int) -> Frame:
        """Read a frame.

        Raises:
            DataError: If a message is damaged, or of another size than the camera; the message names it.
            IndexError: If the index is out of range.
        """
        check_index(index, len(self), self.name)
        number = int(self._chosen[index])
        image = self._levels.to_8_bits(self._picture(number))
        if image.shape[:2] != (self.camera.height, self.camera.width):
            raise DataError(
                f"{self._images.where(number)} is {image.shape[1]}x{image.shape[0]} pixels, but the camera of the "
                f"recording is {self.camera.width}x{self.camera.height}; choose other frames with data.start and "
                "data.stop."
            )
        depth = None
        if self._depths is not None:
            depth = self.depth(index)
            depth = np.zeros(image.shape[:2], np.float32) if depth is None else depth
        return Frame(index, float(self.timestamps[index]), self._undistorter.image(image), depth)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Read the depth of a frame, (H, W) float32 metres with 0 where unknown, or None.

        Raises:
            DataError: If the message is damaged.
        """
        if self._depths is None or self._partners[index] < 0:
            return None
        number = int(self._partners[index])
        where = self._depths.where(number)
        return self._undistorter.depth(self._depth_reader.metres(depth_of(self._depths.read(number), where), where))

    def _picture(self, number: int) -> NDArray[Any]:
        """Return image ``number`` of the bag, (H, W, 3) RGB with the bits that it has."""
        return image_of(self._images.read(number), self._images.where(number))

    def _depth_messages(self, bag: Bag, topics: Topics) -> tuple[Messages | None, NDArray[np.int64]]:
        """Return the depth messages, None without, and the number of each frame's own, -1 without."""
        if topics.depth is None:
            return None, np.full(len(self._chosen), -1)
        depths = Messages(bag, topics.depth)
        partners = partners_of_images(depths.stamps / 1e9, self._images.stamps / 1e9, bag.path)[self._chosen]
        warn_if_few([None if partner < 0 else partner for partner in partners], bag.path)
        return depths, partners

    def _camera(
        self, bag: Bag, topics: Topics, camera: str | Path | Mapping[str, Any] | None, fov: float | None
    ) -> PinholeCamera:
        """Return the camera that the user gave, or the bag's own, or another one that is known or estimated."""

        def picture(index: int) -> NDArray[np.uint8]:
            values = self._picture(int(self._chosen[index]))
            return values if values.dtype == np.uint8 else (values >> 8).astype(np.uint8)

        if camera is None and fov is None and topics.info is not None:
            source = f"{topics.info} in {bag.path}"
            rectified = "rect" in topics.image.removesuffix("/compressed").rpartition("/")[2]
            values = camera_values(bag.first(topics.info), rectified, source)
            if values is not None:
                height, width = picture(0).shape[:2]
                return camera_from_values(values, source, width, height)
            log.warning("%s is not calibrated.", source)
        beside = bag.path.with_name(f"{self.name}.camera.yaml")
        return known_or_estimated(camera, fov, beside, bag.path, picture, len(self._chosen))

    def _remarks(self) -> list[str]:
        """Return what was understood of the messages, and warn of those that are left out."""
        for messages in (self._images, self._depths):
            if messages is not None and messages.left_out:
                log.warning(
                    "%d message(s) of %s in %s are damaged or have the time of another one, and are left out.",
                    *(messages.left_out, messages.topic, messages.bag.path),
                )
        return [] if self._images.timed else ["headers without times, so those of the recording are taken"]


def _is_bag(path: Path) -> bool:
    return (path / METADATA).is_file() if path.is_dir() else path.suffix in SUFFIXES


def _bags(folder: Path) -> dict[str, Path]:
    """Return the bags of a folder by the names of their files."""
    found = {path.name: path for path in visible(folder) if _is_bag(path)}
    if not found:
        mend = or_unpack(folder, "check the option data.root")
        raise DataError(f"{folder} holds no bags ({', '.join(SUFFIXES)}, or folders with {METADATA}); {mend}.")
    return found


def _find(root: Path, sequence: str | None) -> Path:
    """Return the bag that is meant."""
    if root.is_dir() and not _is_bag(root):
        return _bags(root)[choose(sequence, _bags(root), root)]
    if not root.is_dir():
        require_file(root, "the bag of data.root")
        if not _is_bag(root):
            mend = "for a video take data=video" if root.suffix.lower() in VIDEO_SUFFIXES else "check data.root"
            raise DataError(f"{root} is no bag of ROS ({', '.join(SUFFIXES)}, or a folder with {METADATA}); {mend}.")
    if sequence is not None and sequence not in (root.name, root.stem):
        raise DataError(f"There is no sequence '{sequence}' in the single bag {root}; leave data.sequences empty.")
    return root
