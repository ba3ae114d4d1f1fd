"""Messages of ROS bags in pieces: the records of a chunk are walked in place, so that a bag of any length is never held as a whole.

``rosbags`` opens a bag and knows its topics and types; its own way to the messages, one object for each, costs several times as much.
Layouts: the ROS wiki's "Bags/Format/2.0" and the specification of MCAP.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from operator import itemgetter
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

_U32, _U64 = Struct("<I"), Struct("<Q")
#: Three fields of the header of a message in a bag of ROS 1, of 5 to 12 bytes each: which comes first differs between writers.
_FIELDS = {b"conn=": "I5sI", b"op=": "I3sB", b"time=": "I5sII"}
#: A message of MCAP behind its code and length: channel, sequence, time of logging, time of publishing.
_MESSAGE = Struct("<HIQQ")
#: Messages at once where a storage gives them one by one.
_PIECE = 20_000

Piece = tuple[list[int], list[bytes]]


def indexless(path: Path) -> Any:
    """A reader of ``rosbags`` for a bag of ROS 1 that leaves out the index of its messages, an object for each of them."""
    from rosbags.rosbag1 import Reader

    class Indexless(Reader):  # type: ignore[misc]
        def read_index_data(self, pos: int, indexes: Any) -> None:
            for _ in range(2):  # header and data
                (size,) = _U32.unpack(self.bio.read(4))
                self.bio.seek(size, 1)

    return Indexless(path)


def pieces(bag: Any, topic: str) -> Iterator[Piece]:
    """Yield the times of logging in ns and the serialized messages of a topic, piece by piece as they stand in the bag.

    Parameters
    ----------
    bag : rosbags.highlevel.AnyReader
        Open; a bag of ROS 1 by :func:`indexless`.
    topic : str
    """
    chosen = [c for c in bag.connections if c.topic == topic]
    for reader in bag.readers:
        if not bag.is2:
            yield from _of_ros1(reader, {c.id for c in chosen})
            continue
        for storage in getattr(reader, "storages", [reader]):
            channels = {c.id for c in getattr(storage, "connections", ()) if c.topic == topic}
            if getattr(storage, "chunks", None) and not getattr(reader.metadata, "compression_mode", None):
                yield from _of_mcap(storage.path, channels)
            else:
                yield from _one_by_one(reader, chosen)
                break


def _one_by_one(reader: Any, chosen: list[Any]) -> Iterator[Piece]:
    times: list[int] = []
    messages: list[bytes] = []
    for _, time, raw in reader.messages(connections=chosen):
        times.append(time)
        messages.append(raw)
        if len(times) == _PIECE:
            yield times, messages
            times, messages = [], []
    if times:
        yield times, messages


def _of_ros1(reader: Any, wanted: set[int]) -> Iterator[Piece]:
    """Pieces of the chunks that hold these connections."""
    for info in sorted(reader.chunk_infos, key=lambda x: x.pos):
        if not wanted & set(info.connection_counts):
            continue
        chunk = reader.chunks[info.pos]
        reader.bio.seek(chunk.datapos)
        data = chunk.decompressor(reader.bio.read(chunk.datasize))
        times: list[int] = []
        messages: list[bytes] = []
        layout, at = _NO_MESSAGE, 0
        while at < len(data):
            (size,) = _U32.unpack_from(data, at)
            behind = at + 4 + size
            (length,) = _U32.unpack_from(data, behind)
            end = behind + 4 + length
            fields = layout.form.unpack_from(data, at + 4) if layout.form.size == size else ()
            if not fields or layout.names(fields) != layout.expected:
                layout = _layout(data[at + 4 : behind])
                fields = layout.form.unpack_from(data, at + 4) if layout.form.size == size else ()
            if fields and fields[layout.code] == 2 and fields[layout.connection] in wanted:
                if end > len(data):
                    raise ValueError("a message is cut off")
                times.append(fields[layout.time] * 1_000_000_000 + fields[layout.time + 1])
                messages.append(data[behind + 4 : end])
            at = end
        if times:
            yield times, messages


class _Layout(NamedTuple):
    """How the header of a message is laid out: its names and how they should read, and which fields are connection, code and time."""

    form: Struct
    names: Callable[[tuple[Any, ...]], Any]
    expected: tuple[bytes, ...]
    connection: int
    code: int
    time: int


_NO_MESSAGE = _Layout(Struct(""), tuple, (), 0, 0, 0)


def _layout(head: bytes) -> _Layout:
    """The layout of a header; that of no message where it has other fields."""
    at, form, places = 0, "<", dict[bytes, int]()
    while at < len(head):
        (size,) = _U32.unpack_from(head, at)
        name = head[at + 4 : at + 4 + size].partition(b"=")[0] + b"="
        if name not in _FIELDS or Struct("<" + _FIELDS[name]).size != size + 4:
            return _NO_MESSAGE
        places[name] = len(Struct(form).unpack(bytes(Struct(form).size))) + 1
        form += _FIELDS[name]
        at += 4 + size
    if set(places) != set(_FIELDS):
        return _NO_MESSAGE
    connection, code, time = (places[name] + 1 for name in _FIELDS)
    return _Layout(Struct(form), itemgetter(*places.values()), tuple(places), connection, code, time)


def _of_mcap(path: Path, wanted: set[int]) -> Iterator[Piece]:
    """Pieces of the chunks of an MCAP file."""
    from rosbags.rosbag2.storage_mcap import decompress

    with path.open("rb") as file:
        file.seek(8)
        while True:
            head = file.read(9)
            if len(head) < 9 or head[0] in (0x02, 0x0F):  # footer, end of data
                return
            (size,) = _U64.unpack_from(head, 1)
            if head[0] != 0x06:
                file.seek(size, 1)
                continue
            record = file.read(size)
            _, _, unpacked, crc, name = Struct("<QQQII").unpack_from(record)
            (packed,) = _U64.unpack_from(record, 32 + name)
            start = 40 + name
            data = decompress(record[start : start + packed], record[32 : 32 + name].decode(), unpacked, crc)
            piece = _messages_of(data, wanted)
            if piece[0]:
                yield piece


def _messages_of(data: bytes, wanted: set[int]) -> Piece:
    times: list[int] = []
    messages: list[bytes] = []
    at = 0
    while at < len(data):
        (size,) = _U64.unpack_from(data, at + 1)
        if data[at] == 0x05:
            channel, _, time, _ = _MESSAGE.unpack_from(data, at + 9)
            if channel in wanted:
                if at + 9 + size > len(data):
                    raise ValueError("a message is cut off")
                times.append(time)
                messages.append(data[at + 9 + _MESSAGE.size : at + 9 + size])
        at += 9 + size
    return times, messages
