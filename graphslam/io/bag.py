"""An open bag: its topics and messages. Errors of ``rosbags`` become one sentence with the file and the likely cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FormatError, shortened
from ..files import check_unpacked

#: the first bytes of files
MAGIC = {"ROS 1": b"#ROSBAG V", "MCAP": b"\x89MCAP0\r\n", "SQLite": b"SQLite format 3\x00"}
#: the suffix of each kind of file
SUFFIXES = {".bag": "ROS 1", ".mcap": "MCAP", ".db3": "SQLite"}
INSTALL = "bags are read by the package rosbags: pip install -e '.[ros]' in the clone, or pip install rosbags"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name, type: "/odom", "nav_msgs/msg/Odometry".
        count: the number of its messages.
    """

    name: str
    type: str
    count: int


@dataclass(frozen=True)
class Bag:
    """An open bag.

    Attributes:
        path: the file or folder.
        topics: in the order of their names.
        types: field definitions by type, of ``rosbags``.
        reader: of ``rosbags``.
    """

    path: Path
    topics: tuple[Topic, ...]
    types: Any
    reader: Any

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of recording [ns], message) of some topics; the bag is streamed.

        Raises:
            FormatError: a message cannot be read.
        """
        connections = [each for each in self.reader.connections if each.topic in topics]
        if not connections:
            return
        count = 0
        with _errors(self.path, lambda: f" after {count} messages"):
            for connection, time, raw in self.reader.messages(connections=connections):
                count += 1
                yield connection.topic, time, self.reader.deserialize(raw, connection.msgtype)


def is_bag(path: Path, head: bytes) -> bool:
    """Whether a file or folder is a bag, by its first bytes or its metadata."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return head.startswith((MAGIC["ROS 1"], MAGIC["MCAP"])) or path.suffix.lower() in SUFFIXES


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag.

    Raises:
        FormatError: it cannot be read; the message has the likely cause.
    """
    _check_head(path)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise FormatError(path, None, INSTALL) from None
    with _errors(path):
        # the definitions of older bags of ROS 2, which have none of their own
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        with _errors(path):
            topics = tuple(
                Topic(name, info.msgtype or "several types", info.msgcount)
                for name, info in sorted(reader.topics.items())
            )
        if not all(isinstance(text, str) for topic in topics for text in (topic.name, topic.type)):
            raise FormatError(path, None, "the name or type of a topic is no text; was the file damaged?")
        yield Bag(path, topics, reader.typestore.fielddefs, reader)
    finally:
        reader.close()


def _check_head(path: Path) -> None:
    """Raise `FormatError` for a file that is empty, compressed as a whole, or begins as no bag does."""
    if path.is_dir():
        return
    with path.open("rb") as stream:
        head = stream.read(16)
    if not head:
        raise FormatError(path, None, "the file is empty; was the recording ended before anything was written?")
    check_unpacked(path, head)
    for suffix, kind in SUFFIXES.items():
        if head.startswith(MAGIC[kind]) and path.suffix.lower() in SUFFIXES and path.suffix.lower() != suffix:
            raise FormatError(
                path, None, f"its content is that of {kind}; give it the name {path.with_suffix(suffix).name}"
            )
    if not head.startswith(tuple(MAGIC.values())):
        raise FormatError(
            path, None, "not a readable bag: it does not begin as one of ROS 1, MCAP or SQLite; was it overwritten, or is it "
            "another kind of file with this name?",
        )  # fmt: skip


@contextmanager
def _errors(path: Path, where: Any = lambda: "") -> Iterator[None]:
    """Turn whatever ``rosbags`` raises about damaged files into a `FormatError`."""
    try:
        yield
    except FormatError:
        raise
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror or error}") from None
    except Exception as error:  # damaged files raise whatever the parser stumbles over
        raise FormatError(path, None, _cause(path, error) + where()) from None


def _cause(path: Path, error: Exception) -> str:
    """A sentence on a damaged or unknown file."""
    text = shortened(" ".join(str(error).split()).rstrip(".")) or type(error).__name__
    kind = "folder" if path.is_dir() else path.suffix.lower()
    if "not indexed" in text or "index looks damaged" in text:
        return f"the bag has no complete index, it was cut short; repair it first: rosbag reindex {path.name}"
    if "end magic" in text or "footer" in text or "Truncated" in text or "summary offset" in text:
        return f"the bag was cut short ({text}); repair it first: mcap recover {path.name} -o repaired.mcap"
    if "Profile is not ros2" in text or (kind == ".mcap" and isinstance(error, KeyError)):
        return (
            "the messages of this MCAP file are not those of ROS 2 (Protobuf, JSON, or ROS 1); convert it to ROS 2 first, or "
            "export tables"
        )
    if "no type definitions" in text or "TypesysError" in type(error).__name__:
        return f"the bag lacks the definition of a message type ({text}); convert it to MCAP, which holds them"
    return f"not a readable bag ({text}); was it cut short?"
