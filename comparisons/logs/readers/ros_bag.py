"""Opening ROS bags with the `rosbags` package, an optional extra; faults name topic and message.

Messages are decoded by the package's own definitions of the standard types. Those that a bag brings
along the package turns into code; they are taken for `vision_msgs` alone, which it does not have,
and there only plain fields with plain names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from comparisons.errors import InputError, check_regular, printable, shorten

_MAGICS = {b"\x89MCAP0\r\n": "ros2", b"#ROSBAG V": "ros1", b"SQLite format 3\0": "ros2"}
_METADATA = "metadata.yaml"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
LASER, CLOUD, ODOMETRY, FIX, MARKERS, BOXES, IMAGE_BOXES = READ = (
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/NavSatFix",
    "visualization_msgs/msg/MarkerArray",
    "vision_msgs/msg/Detection3DArray",
    "vision_msgs/msg/Detection2DArray",
)
"""The types that are read."""
_BROUGHT = "vision_msgs/msg/"
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms\n"


@dataclass(frozen=True)
class Topic:
    """Messages of one type under one name. connections: the package's own records of them."""

    name: str
    kind: str
    count: int
    connections: tuple[Any, ...]


class Bag:
    """An open bag."""

    def __init__(
        self, path: Path, reader: Any, decode: Any, types: Any, chosen: tuple[str, ...] = ()
    ) -> None:
        """reader: one of the package's, open. decode: from bytes and a type's name to a message.

        types: those that can be decoded. chosen: names of topics that a user asked for.
        """
        self.path, self._reader, self._decode = path, reader, decode
        self._types, self._chosen = types, chosen

    def check_chosen(self, kinds: tuple[str, ...]) -> None:
        """Raise InputError unless the bag has each topic that was chosen, of one of the types.

        No two may be of the same type.
        """
        path, chosen = self.path, self._chosen
        if not chosen:
            return
        known = self.kinds()
        for name in chosen:
            if name not in known:
                reported = ", ".join(f"{one} ({kind})" for one, kind in sorted(known.items()))
                raise InputError(
                    f"{path}: no topic {shorten(name)}, expected some of {shorten(reported, 2000)}"
                )
        for name in chosen:
            same = [one for one in chosen if known[one] == known[name]]
            if len(same) > 1 or known[name] not in kinds:
                what = "is of the same type" if len(same) > 1 else f"is of type {known[name]}"
                wanted = "one of each" if len(same) > 1 else f"one of {', '.join(kinds)}"
                raise InputError(f"{path}: topic {same[-1]} {what}, expected {wanted}")

    def knows(self, kind: str) -> bool:
        """Whether messages of a type can be decoded."""
        return kind in self._types

    def is_chosen(self, topic: Topic) -> bool:
        """Whether a user asked for this topic by its name."""
        return topic.name in self._chosen

    def topic(self, kind: str) -> Topic | None:
        """The topic of a type that is to be read: the one chosen, else the only one; None for none.

        Raises InputError where there are several and none of them is chosen: nothing in a bag says
        which of them a vehicle's odometry is, and which an estimate.
        """
        topics = self.topics(kind)
        if len(topics) > 1 and not self.is_chosen(topics[0]):
            names = ", ".join(f"{topic.name} ({topic.count} messages)" for topic in topics)
            raise InputError(
                f"{self.path}: {len(topics)} topics of type {kind}: {shorten(names, 2000)}; "
                "expected one, say which by --topic NAME"
            )
        return topics[0] if topics else None

    def kinds(self) -> dict[str, str]:
        """Types of all topics by name, those without messages, too."""
        return {str(c.topic): str(c.msgtype) for c in self._reader.connections}

    def topics(self, kind: str) -> list[Topic]:
        """Topics of a type such as `sensor_msgs/msg/LaserScan`, the one that was chosen first.

        Topics without messages are left out; those with most messages stand first, equal ones by
        name.
        """
        found: dict[str, list[Any]] = {}
        try:
            for connection in self._reader.connections:
                if connection.msgtype == kind:
                    found.setdefault(connection.topic, []).append(connection)
            topics = [
                Topic(printable(name), kind, sum(int(c.msgcount) for c in group), tuple(group))
                for name, group in found.items()
            ]
        except Exception as error:  # what the bag's metadata hold may be of any type
            raise InputError(f"{self.path}: topics cannot be listed ({_cause(error)})") from None
        kept = (t for t in topics if t.count)
        return sorted(kept, key=lambda t: (not self.is_chosen(t), -t.count, t.name))

    def messages(self, topic: Topic) -> Iterator[tuple[str, int, Any]]:
        """Each message of a topic: where it is, for errors; when it was recorded [ns]; itself.

        Raises InputError at the first that cannot be read.
        """
        source = self._reader.messages(connections=topic.connections)
        for index in count():
            place = f"{self.path}: {topic.name}, message {index}"
            try:
                _, recorded_ns, raw = next(source)
                message = self._decode(raw, topic.kind)
            except StopIteration:
                return
            except Exception as error:  # the package, its codecs and numpy fail in many ways
                raise InputError(f"{place}: cannot be read ({_cause(error)})") from None
            yield place, recorded_ns, message


def recognise_bag(path: Path) -> str | None:
    """`ros1` or `ros2` for a bag's file or folder, by its content; None for anything else."""
    try:
        if path.is_dir():
            if not (path / _METADATA).is_file():
                return None
            with (path / _METADATA).open("rb") as file:
                return "ros2" if b"rosbag2_bagfile_information" in file.read(4096) else None
        if not path.is_file():
            return None
        with path.open("rb") as file:
            start = file.read(16)
    except OSError:
        return None
    return next((ros for magic, ros in _MAGICS.items() if start.startswith(magic)), None)


@contextmanager
def open_bag(
    path: Path, topics: tuple[str, ...] = (), kinds: tuple[str, ...] = READ
) -> Iterator[Bag]:
    """Open a bag. Raises InputError for what is no bag, and where the extra is not installed.

    topics: names of those that a user asked for. kinds: the types that they may be of.
    """
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise InputError(
            f"{path}: reading ROS bags needs the extra ros: pip install slamcheck[ros]"
        ) from None
    ros = recognise_bag(path)
    if ros is None:
        raise InputError(f"{path}: not a ROS bag, expected .mcap, .bag, .db3 or a rosbag2 folder")
    for part in path.iterdir() if path.is_dir() else (path,):
        check_regular(part)
    reader: Any
    try:
        if ros == "ros1":
            store = get_typestore(Stores.ROS1_NOETIC)
            store.register(get_types_from_msg(_TRANSFORMS, TRANSFORMS))  # missing in that one
            reader, decode = Reader1(path), store.deserialize_ros1
        else:
            store = get_typestore(Stores.ROS2_HUMBLE)
            reader, decode = Reader2(path), store.deserialize_cdr
        reader.open()
        _register(store, reader)
    except Exception as error:  # the package and what it builds on fail in many ways
        raise InputError(f"{path}: not a readable ROS bag ({_cause(error)})") from None
    try:
        bag = Bag(path, reader, decode, store.types, topics)
        bag.check_chosen(kinds)
        yield bag
    finally:
        reader.close()


def _register(store: Any, reader: Any) -> None:
    """Add the definitions of `vision_msgs` that a bag brings along, as far as they are any."""
    for connection in reader.connections:
        if str(connection.msgtype).startswith(_BROUGHT) and connection.msgdef.data:
            with suppress(Exception):  # the bag may hold what can be read all the same
                store.register(_definitions(store, connection))


def _definitions(store: Any, connection: Any) -> dict[str, Any]:
    """A connection's own types without their constants. Raises ValueError for names that are none.

    The package turns names into code.
    """
    from rosbags.typesys import get_types_from_msg

    found = get_types_from_msg(connection.msgdef.data, connection.msgtype)
    brought: dict[str, Any] = {
        name: ([], fields)
        for name, (_, fields) in found.items()
        if name.startswith(_BROUGHT) and name not in store.fielddefs
    }
    for name, (_, fields) in brought.items():
        for word in (name, *(field for field, _ in fields)):
            if not _PLAIN.fullmatch(word):
                raise ValueError(f"{word} is no name of a message or field")
    return brought


def _cause(error: Exception) -> str:
    text = " ".join(str(error).split())
    return shorten(text or type(error).__name__, 120)
