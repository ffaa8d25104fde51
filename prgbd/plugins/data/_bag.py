"""A ROS bag of version 1 or 2: its topics, and the messages of each by number, read on demand by ``rosbags``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from prgbd.core.errors import DataError, PrgbdError

SUFFIXES = (".bag", ".db3", ".mcap")
METADATA = "metadata.yaml"  # in the folder that is a bag of version 2
FORWARD = 8  # messages that are read and dropped rather than sought over
LONGEST = 120  # characters of what the library says of a damaged bag

# The definitions in a bag itself are not asked: those of images never changed, and one bad one would spoil the rest.
_TYPES: dict[bool, Typestore] = {}


class Bag:
    """A bag and what it holds.

    Args:
        path: A ``.bag`` file of version 1; a folder with ``metadata.yaml``, or one of its files, of version 2.

    Attributes:
        topics: The type of the messages of each topic that has any.

    Raises:
        DataError: If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _told(path), self.opened() as reader:
            self.topics: dict[str, str] = {c.topic: c.msgtype for c in reader.connections if c.msgcount}

    def opened(self) -> Any:
        """Return a new reader of the library, opened where it is used in a ``with`` statement."""
        return (rosbag1 if self.is_first_version else rosbag2).Reader(self.path)

    @property
    def is_first_version(self) -> bool:
        """Whether it is a bag of ROS 1."""
        return self.path.suffix == ".bag"

    def of_type(self, *types: str) -> list[str]:
        """Return the topics whose messages are of one of these types of ``sensor_msgs``."""
        return [topic for topic, found in sorted(self.topics.items()) if found.rpartition("/")[2] in types]

    def message(self, topic: str, data: bytes) -> Any:
        """Return a message from its bytes; the library raises many kinds of errors."""
        first = self.is_first_version
        if first not in _TYPES:
            _TYPES[first] = get_typestore(Stores.ROS1_NOETIC if first else Stores.LATEST)
        types = _TYPES[first]
        return (types.deserialize_ros1 if first else types.deserialize_cdr)(data, self.topics[topic])

    def first(self, topic: str) -> Any:
        """Return the first message of a topic.

        Raises:
            DataError: If it is damaged.
        """
        with _told(self.path, f"the first message of {topic}"), self.opened() as reader:
            return self.message(topic, next(_messages(reader, topic))[1])


class Messages:
    """The messages of one topic by number, ordered by the times in their headers. The bag is read once to index it.

    A copy in another process opens the bag for itself.

    Args:
        bag: The bag.
        topic: The topic.

    Attributes:
        stamps: (N,) nanoseconds of the headers, strictly ascending, or of the recording where headers have no time.
        timed: Whether they are those of the headers.
        left_out: Number of messages that are damaged, or have the time of another one.

    Raises:
        DataError: If the bag is damaged, or no message of the topic can be read.
    """

    def __init__(self, bag: Bag, topic: str) -> None:
        self.bag, self.topic = bag, topic
        logged, stamps = [], []
        with _told(bag.path), bag.opened() as reader:
            for time, data in _messages(reader, topic):
                logged.append(time)
                stamps.append(self._stamp(data))
        self._logged = np.array(logged, np.int64)
        given = np.array(stamps, np.int64)
        self.timed = bool((given > 0).any())
        given = given if self.timed else np.where(given < 0, given, self._logged)
        order = np.argsort(given, kind="stable")
        order = order[given[order] > (0 if self.timed else -1)]
        fresh = np.append(True, np.diff(given[order]) > 0) if len(order) else np.zeros(0, bool)
        self._places = order[fresh]
        self.stamps = given[self._places]
        self.left_out = len(given) - len(self._places)
        if not len(self):
            raise DataError(f"No message of {topic} in {bag.path} can be read; the bag is damaged, copy it anew.")
        self._reader: Any = None
        self._pass: Iterator[tuple[int, bytes]] | None = None
        self._next = self._owner = 0

    def __len__(self) -> int:
        return len(self._places)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_reader": None, "_pass": None}

    def read(self, number: int) -> Any:
        """Return message ``number``.

        Raises:
            DataError: If it is damaged.
        """
        place = int(self._places[number])
        with _told(self.bag.path, self.where(number)):
            try:
                return self.bag.message(self.topic, self._bytes(place))
            except BaseException:
                self._forget()
                raise

    def where(self, number: int) -> str:
        """Return the words that name a message in errors."""
        return f"Message {int(self._places[number])} of {self.topic} in {self.bag.path}"

    def _bytes(self, place: int) -> bytes:
        """Read on, or from the message's time of recording on."""
        if self._owner != os.getpid():
            self._forget()
        if self._pass is None or not self._next <= place <= self._next + FORWARD:
            if self._reader is None:
                self._reader, self._owner = self.bag.opened(), os.getpid()
                self._reader.open()
            time = int(self._logged[place])
            self._pass = _messages(self._reader, self.topic, time)
            self._next = int(np.searchsorted(self._logged, time))
        while True:
            _, data = next(self._pass)
            self._next += 1
            if self._next > place:
                return data

    def _forget(self) -> None:
        self._reader = self._pass = None

    def _stamp(self, data: bytes) -> int:
        """Return the time of a message's header in nanoseconds, 0 if it has none, -1 if it is damaged."""
        try:
            stamp = self.bag.message(self.topic, data).header.stamp
        except Exception:  # the library has no class of its own for damaged messages
            return -1
        return max(0, int(stamp.sec) * 10**9 + int(stamp.nanosec))


def _messages(reader: Any, topic: str, start: int | None = None) -> Iterator[tuple[int, bytes]]:
    """Yield the times of recording and the bytes of a topic's messages from a time on."""
    connections = [c for c in reader.connections if c.topic == topic and c.msgcount]
    for _, time, data in reader.messages(connections, start=start):
        yield time, data


@contextlib.contextmanager
def _told(path: Path, what: str = "") -> Iterator[None]:
    """Turn whatever the library says against a bag into one sentence."""
    try:
        yield
    except PrgbdError:
        raise
    except Exception as error:  # damaged bags make it raise nearly anything
        said = " ".join(str(error).split())[:LONGEST] or type(error).__name__
        if what:
            mend = "choose other frames with data.start and data.stop, or copy the bag anew"
            raise DataError(f"{what} cannot be read, for the bag is damaged there ({said}); {mend}.") from error
        tool = {".bag": "rosbag reindex", ".mcap": "mcap recover"}.get(path.suffix, "ros2 bag reindex")
        raise DataError(
            f"{path} is truncated, damaged or no bag ({said}); copy it anew, or repair it with '{tool}'."
        ) from error
