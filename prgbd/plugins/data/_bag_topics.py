"""Which topics of a bag are the images, their depth and their camera."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from prgbd.core.errors import DataError
from prgbd.core.option_errors import listed
from prgbd.plugins.data._bag import Bag
from prgbd.plugins.data._bag_messages import is_depth

IMAGES, INFO = ("Image", "CompressedImage"), "CameraInfo"
TRANSPORTS = ("/compressed", "/compressedDepth")  # under which the same pictures are recorded once more


@dataclass(frozen=True)
class Topics:
    """What was chosen.

    Attributes:
        image: The images.
        depth: Their depth, or None.
        info: Their camera, or None.
        remarks: What was chosen by itself, in clauses for the user.
    """

    image: str
    depth: str | None
    info: str | None
    remarks: tuple[str, ...]


def choose_topics(bag: Bag, image: str | None, depth: str | None, info: str | None) -> Topics:
    """Choose what the user did not.

    Raises:
        DataError: If a topic that was given is not there, or several could be meant; the message lists them.
    """
    firsts = {topic: bag.first(topic) for topic in bag.of_type(*IMAGES)}
    pictures = [topic for topic, message in firsts.items() if not is_depth(message)]
    depths = [topic for topic, message in firsts.items() if is_depth(message)]
    if image is None and not pictures:
        raise DataError(
            f"{bag.path} has no topic of images (sensor_msgs/Image or CompressedImage); its topics are "
            f"{listed(sorted(bag.topics)) or 'none'}."
        )
    image = _given(bag, image, firsts, "image") or _single(bag, pictures, "image")
    frame = _frame(firsts[image])
    remarks = [f"images of {image}"]
    same = [topic for topic in depths if _frame(firsts[topic]) == frame]
    chosen = _given(bag, depth, firsts, "depth") or (_single(bag, same, "depth") if same else None)
    if chosen is not None:
        remarks.append(f"depth of {chosen}")
    elif depths:
        other = _frame(firsts[depths[0]])
        remarks.append(f"depth of {depths[0]} left out, for it is in the frame '{other}' and not in '{frame}'")
    infos = bag.of_type(INFO)
    return Topics(image, chosen, _given(bag, info, infos, "info") or _info(bag, image, frame, infos), tuple(remarks))


def _given(bag: Bag, topic: str | None, candidates: Iterable[str], option: str) -> str | None:
    """Return the topic that a user gave, None if none."""
    known = list(candidates)
    if topic is None or topic in known:
        return topic
    raise DataError(
        f"{bag.path} has no topic '{topic}' for data.{option}; there are {listed(known) or 'none of this kind'}."
    )


def _single(bag: Bag, candidates: list[str], option: str) -> str:
    """Return the only topic; one that is recorded both raw and compressed counts once, and raw."""
    raw = [topic for topic in candidates if not any(topic == f"{other}{t}" for other in candidates for t in TRANSPORTS)]
    if len(raw) > 1:
        raise DataError(f"{bag.path} has {len(raw)} topics that data.{option} can be; set it to one of {listed(raw)}.")
    return raw[0]


def _info(bag: Bag, image: str, frame: str, infos: list[str]) -> str | None:
    """Return the topic of the camera: ``camera_info`` beside the images, or the only one of their frame."""
    plain = next((image.removesuffix(t) for t in TRANSPORTS if image.endswith(t)), image)
    beside = f"{plain.rpartition('/')[0]}/camera_info"
    if beside in infos:
        return beside
    same = [topic for topic in infos if _frame(bag.first(topic)) == frame]
    return _single(bag, same, "info") if same else None


def _frame(message: Any) -> str:
    """Return the frame of coordinates of a message; ROS 1 wrote some with a slash."""
    return str(message.header.frame_id).lstrip("/")
