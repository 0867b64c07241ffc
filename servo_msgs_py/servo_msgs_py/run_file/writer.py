"""Writer of a recording: serialised ROS messages into an MCAP file that rosbag2 and other tools read as it is."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import Writer

from servo_msgs_py.output_file import named, open_output
from servo_msgs_py.run_file.definitions import definition, without_padding
from servo_msgs_py.run_file.topic import Topic

_CHUNK_BYTES: Final = 1 << 20
"""Size from which the library completes a chunk by itself [bytes]."""

_LIBRARY: Final = "servo_msgs_py"


class UnknownTypeError(ValueError):
    """There is no definition of a message type; the text has its name."""


class RunWriter:
    """A new file; as a context it is completed at the end.

    What was written before the last `flush` is readable even if the process is killed.

    Parameters
    ----------
    path : Path
        Must not exist; its folder is created.

    Raises
    ------
    OSError
        If it exists or cannot be written; with its name. So do all methods.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with named(path):
            self._stream = open_output(path, "xb")
            # Message indexes cost a fifth of the size, but rosbag2 finds no message of a file without them.
            self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES)
            self._schemas: dict[str, int] = {}
            self._channels: dict[Topic, int] = {}
            self._sequences: dict[int, int] = {}
            self._kept = 0
            self._failed = False
            self._writer.start(Profile.ROS2, _LIBRARY)
            self.flush()

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Bytes of the file up to the last `flush`."""
        return self._kept

    def write(self, topic: Topic, data: bytes, time_ns: int, published_ns: int | None = None) -> None:
        """Add a message.

        Parameters
        ----------
        topic : Topic
        data : bytes
            Serialised message (CDR with its header).
        time_ns : int
            Time of the recording since the epoch [ns].
        published_ns : int, optional
            Time of the publication [ns]; default: `time_ns`.

        Raises
        ------
        UnknownTypeError
            If the type of the topic is not known.
        """
        with self._writing():
            channel = self._channels.get(topic) or self._channel(topic)
            self._sequences[channel] = sequence = self._sequences[channel] + 1
            published = time_ns if published_ns is None else published_ns
            self._writer.add_message(channel, time_ns, without_padding(data, topic.type), published, sequence)

    def flush(self) -> None:
        """Complete the chunk in progress and hand everything to the system."""
        with self._writing():
            self._writer.flush()
            self._kept = self._stream.tell()

    def close(self) -> None:
        """Complete the file; after an error close it with what was completely written before."""
        try:
            if not self._failed:
                with self._writing():
                    self._writer.finish()
                    self._stream.flush()
                    self._kept = self._stream.tell()
        finally:
            with contextlib.suppress(OSError):
                self._stream.close()
            with contextlib.suppress(OSError):
                os.truncate(self._path, self._kept)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """After an error the library would write a chunk again behind the part that is in the file."""
        try:
            with named(self._path):
                yield
        except OSError:
            self._failed = True
            raise

    def _channel(self, topic: Topic) -> int:
        known = definition(topic.type)
        if known is None:
            raise UnknownTypeError(f"{topic.name}: no definition of the type {topic.type}")
        schema = self._schemas.get(topic.type)
        if schema is None:
            schema = self._writer.register_schema(topic.type, SchemaEncoding.ROS2, known.text.encode())
            self._schemas[topic.type] = schema
        about = {"offered_qos_profiles": topic.qos, "topic_type_hash": known.hash}
        channel = self._writer.register_channel(topic.name, MessageEncoding.CDR, schema, about)
        self._channels[topic] = channel
        self._sequences[channel] = 0
        return channel
