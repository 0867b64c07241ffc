"""Reader of recordings: those of `RunWriter`, and bags that rosbag2 or other tools have written.

It reads what is there: a file that was cut off up to its last complete chunk, and files without summary or metadata.
What is missing is said in `RunReader.troubles`.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, Any, Final, NamedTuple, cast
from zlib import crc32

import yaml
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import (
    EndOfFile,
    InvalidMagic,
    McapError,
    RecordLengthLimitExceeded,
    UnsupportedCompressionError,
)
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import read_magic
from mcap.well_known import MessageEncoding
from zstandard import FRAME_HEADER, ZstdDecompressor, ZstdError

from servo_msgs_py.run_file.series import segment, segments, split
from servo_msgs_py.run_file.sqlite_bag import rows
from servo_msgs_py.text_file import read_text
from servo_msgs_py.topics import RUN_LOST

_METADATA: Final = "metadata.yaml"
RUN_SUFFIXES: Final = (".mcap", ".db3")
_PACKED: Final = ".zstd"  # suffix behind these of a file that rosbag2 has compressed
_REMEDY: Final = "give a .mcap or .db3 file, or the folder of a bag"

_DAMAGE: Final = (McapError, ZstdError, struct.error, ValueError, RuntimeError, OverflowError)
"""Errors of the libraries for damaged contents."""


_BYTES_MAX: Final = 256_000_000
"""Largest record of an MCAP file, packed and unpacked [bytes]."""

_SQLITE_MAX: Final = 1 << 40
"""Largest SQLite file that is completed with empty pages, which take no room on the disk [bytes]."""

_PIECE: Final = 1 << 20
"""Of a file that is copied [bytes]."""

_LOST: Final = f"/{RUN_LOST}"

_PARSERS: Final[Mapping[int, Callable[[ReadDataStream], McapRecord]]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.FOOTER: Footer.read,
}
"""Of the entries of an MCAP file that are read, beside the messages."""

_ENTRY: Final = struct.Struct("<BQ")
"""Head of an entry of a chunk: its code, and the length of the rest."""
_MESSAGE: Final = struct.Struct("<HIQQ")
"""Head of a message: channel, number, times of the recording and of the publication."""


class RunFileError(ValueError):
    """A recording cannot be read; the text says which, why and what to do."""


class Record(NamedTuple):
    """One message."""

    topic: str  # absolute, such as ``/servo/snapshot``
    type: str  # such as ``std_msgs/msg/String``
    time_ns: int  # time of the recording since the epoch [ns]; clocks may have jumped
    data: bytes  # serialised message (CDR with its header)


class RunReader:
    """A recording; each call of `records` reads it anew.

    Parameters
    ----------
    path : Path
        A ``.mcap`` or ``.db3`` file, or a folder: a bag of rosbag2, or the segments of one recording. ``run.mcap`` is
        also the name of the recording whose segments are ``run.mcap``, ``run_1.mcap``, ``run_2.mcap``, of which the
        first ones may have been removed.

    Raises
    ------
    RunFileError
        If there is nothing that can be read.
    """

    def __init__(self, path: Path) -> None:
        self._missing: list[str] = []
        self.files: list[Path] = self._folder(path) if path.is_dir() else self._series(path)
        """Files that are read, in order."""
        self.troubles: list[str] = []
        """What was missing in the last `records`, for people; complete at their end."""

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Messages in the order of their recording, which differs from that of their times if the clock has jumped.

        Parameters
        ----------
        topics : collection of str, optional
            Absolute names; default: all.

        Raises
        ------
        RunFileError
            If a file is not in a format that can be read.
        OSError
            If a file cannot be read.
        """
        self.troubles = list(self._missing)
        wanted = None if topics is None else frozenset(topics)
        lost = 0
        for file in self.files:
            for record in self._file(file, wanted):
                if record.topic.endswith(_LOST):
                    lost = int.from_bytes(record.data[4:12], "little")
                    if wanted is not None and record.topic not in wanted:
                        continue
                yield record
        if lost:
            self.troubles.append(f"the recorder has lost {lost} messages because the computer was too slow")

    # ---- files
    def _series(self, path: Path) -> list[Path]:
        """The files of a recording by the path of the first one."""
        if path.suffix == ".bag":
            raise RunFileError(f"{path} is a bag of ROS 1; convert it with rosbags-convert")
        if path.suffix not in RUN_SUFFIXES:
            raise RunFileError(f"{path} is no recording; {_REMEDY}")
        files = [file for file in segments(path) if path.suffix == ".mcap" or file == path]
        if not files:
            raise RunFileError(f"{path}: there is no such recording; {_REMEDY}")
        first = split(files[0])[1] if files[0] != path else 0
        count = next((k for k, file in enumerate(files) if file != segment(path, first + k)), len(files))
        self._missing += [f"{file} does not continue {files[count - 1]} and is left out" for file in files[count:]]
        return files[:count]

    def _folder(self, folder: Path) -> list[Path]:
        listed = [folder / Path(str(name)).name for name in self._metadata(folder).get("relative_file_paths") or []]
        self._missing += [f"{file}, which {_METADATA} lists, is missing" for file in listed if not file.exists()]
        files = [file for file in listed if file.exists()]
        if files:
            return files
        found = [file for suffix in RUN_SUFFIXES for file in folder.glob(f"*{suffix}*") if _kind(file) == suffix]
        names = sorted({split(_unpacked_name(file))[0] + _kind(file) for file in found})
        if not names:
            raise RunFileError(f"{folder} contains no recording; {_REMEDY}")
        if len(names) > 1:
            raise RunFileError(f"{folder} contains several recordings; give one: {', '.join(names)}")
        return sorted(found, key=lambda file: split(_unpacked_name(file)))

    def _metadata(self, folder: Path) -> Mapping[str, Any]:
        path = folder / _METADATA
        try:
            about = yaml.safe_load(read_text(path))["rosbag2_bagfile_information"]
            return about if isinstance(about, Mapping) else {}
        except FileNotFoundError:
            return {}
        except (yaml.YAMLError, TypeError, KeyError, ValueError):
            self._missing.append(f"{path} is damaged: all files of the folder are read")
            return {}

    # ---- contents
    def _file(self, file: Path, wanted: frozenset[str] | None) -> Iterator[Record]:
        """Messages of a file; rosbag2 may have compressed the file, or each message."""
        damaged = 0
        for record in self._mcap(file, wanted) if _kind(file) == ".mcap" else self._sqlite(file, wanted):
            if record.data.startswith(FRAME_HEADER):
                try:
                    yield record._replace(data=ZstdDecompressor().decompress(record.data, _BYTES_MAX))
                except ZstdError:
                    damaged += 1
            else:
                yield record
        if damaged:
            self.troubles.append(f"{file}: {damaged} damaged message{'s' if damaged > 1 else ''} left out")

    def _mcap(self, file: Path, wanted: frozenset[str] | None) -> Iterator[Record]:
        channels = _Channels(wanted)
        damaged, entry = 0, None
        with _opened(file) as stream:
            try:
                for entry in _entries(stream, bytes_max=_BYTES_MAX):
                    if isinstance(entry, Chunk):
                        try:
                            data = _unpacked(entry)
                        except _DAMAGE:
                            damaged += 1
                        else:
                            yield from _messages(data, channels)
                    elif isinstance(entry, Message):
                        channel = channels.taken.get(entry.channel_id)
                        if channel is not None:
                            yield Record(*channel, entry.log_time, entry.data)
                    else:
                        channels.add(entry)
            except InvalidMagic:
                if entry is None:
                    raise RunFileError(f"{file} is no MCAP file; {_REMEDY}") from None
            except RecordLengthLimitExceeded:
                self.troubles.append(f"{file} ends at a record of more than {_BYTES_MAX} bytes, the largest size")
            except _DAMAGE as error:
                damaged += not isinstance(error, EndOfFile)
        self._foreign(file, channels.foreign)
        if damaged:
            self.troubles.append(f"{file}: {damaged} damaged chunk{'s' if damaged > 1 else ''} left out")
        if not isinstance(entry, Footer):
            self.troubles.append(f"{file} is not complete: its recorder was killed, or the file was cut off")

    def _sqlite(self, file: Path, wanted: frozenset[str] | None) -> Iterator[Record]:
        foreign: set[str] = set()
        first = True
        try:
            with _complete_file(file) as complete:
                for row in rows(complete, wanted):
                    first = False
                    if row.encoding == MessageEncoding.CDR:
                        yield Record(row.topic, row.type, row.time_ns, row.data)
                    else:
                        foreign.add(row.topic)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            if first:
                raise RunFileError(f"{file} is no bag that can be read: {error}; {_REMEDY}") from None
            self.troubles.append(f"{file} is damaged, what is before is read: {error}")
        self._foreign(file, foreign)

    def _foreign(self, file: Path, topics: Collection[str]) -> None:
        self.troubles += [f"{file}: {topic} is not read, its encoding is not cdr" for topic in sorted(topics)]


def _unpacked_name(file: Path) -> Path:
    return file.with_suffix("") if file.suffix == _PACKED else file


def _kind(file: Path) -> str:
    """Suffix of a file without that of its compression."""
    return _unpacked_name(file).suffix


@contextmanager
def _complete_file(file: Path) -> Iterator[Path]:
    """An SQLite file; a temporary copy if it is packed, or cut off: with empty pages at its end it can be read."""
    if file.suffix != _PACKED and file.stat().st_size >= _pages(file)[1]:
        yield file
        return
    with _opened(file) as stream, NamedTemporaryFile() as copy:
        with suppress(ZstdError):  # what is before the damage is read
            while data := stream.read(_PIECE):
                copy.write(data)
        copy.flush()
        path = Path(copy.name)
        (page, whole), size = _pages(path), path.stat().st_size
        if size < whole:
            copy.truncate(size // page * page)
            copy.truncate(whole)
        yield path


def _opened(file: Path) -> IO[bytes]:
    """A file that is unpacked as it is read."""
    return cast("IO[bytes]", zstandard.open(file)) if file.suffix == _PACKED else file.open("rb")


def _pages(file: Path) -> tuple[int, int]:
    """Size of a page and of all pages of an SQLite file by its head [bytes]; 1 and 0 if it has none."""
    with file.open("rb") as stream:
        head = stream.read(32)
    if len(head) < 32:
        return 1, 0
    page, count = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    page = page if page > 1 else 1 << 16
    return page, min(page * count, _SQLITE_MAX)


class _Channels:
    """Topics of an MCAP file.

    Parameters
    ----------
    wanted : frozenset of str, optional
        Topics to read; default: all.
    """

    def __init__(self, wanted: frozenset[str] | None) -> None:
        self._wanted = wanted
        self._types: dict[int, str] = {}
        self.taken: dict[int, tuple[str, str]] = {}  # topic and type by number, of the channels to read
        self.foreign: set[str] = set()  # topics in another encoding

    def add(self, entry: object) -> None:
        """Take notice of a schema or a channel."""
        if isinstance(entry, Schema):
            self._types[entry.id] = entry.name
        elif isinstance(entry, Channel):
            if entry.message_encoding != MessageEncoding.CDR:
                self.foreign.add(entry.topic)
            elif self._wanted is None or entry.topic in self._wanted or entry.topic.endswith(_LOST):
                self.taken[entry.id] = (entry.topic, self._types.get(entry.schema_id, ""))


def _unpacked(chunk: Chunk) -> bytes:
    """Contents of a chunk: as `mcap.stream_reader.get_chunk_data_stream`, but never more than the chunk states.

    Raises
    ------
    McapError, ZstdError, RuntimeError, ValueError
        If it is damaged, or larger than a record may be.
    """
    size, data = chunk.uncompressed_size, chunk.data
    if size > _BYTES_MAX:
        raise ValueError(f"{size} bytes")
    if chunk.compression == "zstd":
        data = ZstdDecompressor().stream_reader(data).read(size)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, size)
    elif chunk.compression:
        raise UnsupportedCompressionError(chunk.compression)
    if len(data) != size or chunk.uncompressed_crc not in (0, crc32(data)):
        raise ValueError("not what the chunk states")
    return data


def _entries(stream: IO[bytes], *, bytes_max: int) -> Iterator[McapRecord]:
    """Entries of an MCAP file: as `mcap.stream_reader.StreamReader`, without those that are not needed.

    Parsing the indexes of the messages takes longer than reading the messages.

    Raises
    ------
    McapError, struct.error, ValueError
        If it is damaged.
    """
    read_magic(ReadDataStream(stream))
    code = 0
    while code != Opcode.FOOTER:
        head = stream.read(_ENTRY.size)
        if len(head) < _ENTRY.size:
            raise EndOfFile
        code, length = _ENTRY.unpack(head)
        if length > bytes_max:
            raise RecordLengthLimitExceeded(code, length, bytes_max)
        data = stream.read(length)
        if len(data) < length:
            raise EndOfFile
        if code == Opcode.MESSAGE:
            yield Message.read(ReadDataStream(BytesIO(data)), length)
        elif code in _PARSERS:
            yield _PARSERS[code](ReadDataStream(BytesIO(data)))


def _messages(data: bytes, channels: _Channels) -> Iterator[Record]:
    """Messages of an uncompressed chunk: as `mcap.stream_reader.breakup_chunk`, in a fifth of the time."""
    at, size, taken = 0, len(data), channels.taken
    while at < size:
        code, length = _ENTRY.unpack_from(data, at)
        at += _ENTRY.size
        if code == Opcode.MESSAGE:
            number, _, time_ns, _ = _MESSAGE.unpack_from(data, at)
            if number in taken:
                yield Record(*taken[number], time_ns, data[at + _MESSAGE.size : at + length])
        elif code in (Opcode.SCHEMA, Opcode.CHANNEL):
            channels.add(_PARSERS[code](ReadDataStream(BytesIO(data[at : at + length]))))
        at += length
