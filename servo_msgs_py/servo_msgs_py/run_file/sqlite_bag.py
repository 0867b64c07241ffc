"""Messages of a bag of rosbag2 in an SQLite file, in the order in which they were recorded.

Other readers sort them by time, which mixes those before and after a step of the clock.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote


class Row(NamedTuple):
    """One message."""

    topic: str
    type: str
    encoding: str  # such as ``cdr``
    time_ns: int  # of the recording since the epoch [ns]
    data: bytes


def rows(file: Path, wanted: Collection[str] | None) -> Iterator[Row]:
    """Messages of a file that nobody writes to.

    Parameters
    ----------
    file : Path
    wanted : collection of str, optional
        Topics; default: all.

    Raises
    ------
    sqlite3.Error, UnicodeDecodeError
        If it is no bag, or damaged from here on.
    """
    query = (
        "SELECT name, type, serialization_format, timestamp, data FROM messages "
        "CROSS JOIN topics ON messages.topic_id = topics.id"  # in this order, so that nothing has to be sorted
    )
    names = [] if wanted is None else list(wanted)
    if wanted is not None:
        query += f" WHERE name IN ({', '.join('?' * len(names))})"
    with closing(sqlite3.connect(f"file:{quote(str(file))}?immutable=1", uri=True)) as connection:
        for values in connection.execute(f"{query} ORDER BY messages.id", names):
            if tuple(map(type, values)) != (str, str, str, int, bytes):
                raise sqlite3.DataError(f"a message is {values!r:.80}")
            yield Row(*values)
