"""A recorded run: which board, what is in it, and its messages for the twin."""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

from servo_msgs_py.blocks_message import blocks_from_message
from servo_msgs_py.convert import snapshot_table
from servo_msgs_py.run_file.definitions import decoded
from servo_msgs_py.run_file.reader import Record, RunReader
from servo_msgs_py.run_file.run_info import RunInfo, RunInfoError, run_info, string_of
from servo_msgs_py.run_file.topic import type_of

from servo_msgs_py import topics
from servo_twin.lockstep.blocks import Blocks
from servo_twin.lockstep.board_topics import BOARD_TOPICS
from servo_twin.runs.sample_order import Place, SampleOrder

DEFAULT_NAMESPACE: Final = "/servo"
_HELD: Final = 64
"""Messages of samples that are held back: at least 0.3 s, and 1.4 s of a bridge, which sends four samples in one."""

_MEANING: Final = {
    topics.COMMANDS_APPLIED: "commands cannot be repeated: only the stretches without one can be replayed",
    topics.PARAMETERS: "the parameters of the board are not known; the defaults are assumed",
    topics.TUNING: "the configuration of the board is not known; the one compiled in is assumed",
    topics.WINDING_TEMPERATURES: "the temperatures of the windings are not known",
    topics.RUN_INFO: "plant, seed and build are not known; the packaged plant is assumed, differences within noise "
    "are ignored",
}
"""What a missing topic means for a replay; the others matter only with bursts."""


class RunError(ValueError):
    """A recording cannot be used; the text has the reason and a remedy."""


@dataclass(frozen=True)
class Contents:
    """What a recording has of one board."""

    namespace: str  # of the bridge, absolute
    topics: Counter[str]  # messages by absolute name
    info: RunInfo | None  # what ran; None: not known
    blocks: Blocks  # first configuration blocks; empty: not known
    missing: tuple[str, ...]  # what the recording lacks, and what that means; for people


@dataclass
class _Found:
    """What a first reading finds."""

    topics: Counter[str] = field(default_factory=Counter)
    infos: dict[str, RunInfo] = field(default_factory=dict)  # by topic
    blocks: dict[str, Blocks] = field(default_factory=dict)
    troubles: Counter[str] = field(default_factory=Counter)

    def take(self, record: Record) -> None:
        namespace, _, name = record.topic.rpartition("/")
        self.topics[record.topic] += 1
        try:
            if name == topics.RUN_INFO:
                self._take_info(namespace, run_info(string_of(record.data)))
            elif name == topics.TUNING and not self.blocks.get(namespace):
                self.blocks[namespace] = blocks_from_message(decoded(record.data, record.type))
        except (ValueError, RunInfoError) as error:
            self.troubles[f"{record.topic}: {error}"] += 1

    def _take_info(self, namespace: str, info: RunInfo) -> None:
        """Later documents know more, but not what was lost with the connection."""
        before = self.infos.get(namespace)
        if before is None or info.virtual_board is not None or before.virtual_board is None:
            self.infos[namespace] = info


class RecordedRun:
    """A recording.

    Parameters
    ----------
    path : Path
        As for `RunReader`.
    namespace : str, optional
        Of the bridge; by default ``/servo``, or the only one with telemetry of a board.

    Raises
    ------
    RunError, RunFileError
        If it contains no telemetry of a board, or is no recording.
    OSError
        If it cannot be read.
    """

    def __init__(self, path: Path, namespace: str = "") -> None:
        self.path = path
        self._reader = RunReader(path)
        found = _Found()
        for record in self._reader.records():
            found.take(record)
        chosen = _namespace(path, found.topics, namespace)
        missing = [*self._reader.troubles, *found.troubles]
        missing += [
            f"no {chosen}/{name}: {meaning}"
            for name, meaning in _MEANING.items()
            if not found.topics[f"{chosen}/{name}"]
        ]
        self.contents = Contents(
            chosen,
            found.topics,
            found.infos.get(chosen),
            found.blocks.get(chosen, {}),
            tuple(missing),
        )

    def records(self, *names: str) -> Iterator[tuple[str, Record]]:
        """Relative names and messages of topics of the board, in the order of the recording."""
        prefix = f"{self.contents.namespace}/"
        for record in self._reader.records({prefix + name for name in names}):
            yield record.topic.removeprefix(prefix), record


def message_of(record: Record, name: str) -> Any:
    """Decoded message of a topic in `BOARD_TOPICS`.

    Raises
    ------
    ValueError
        If it has another type, or is damaged.
    """
    expected = _TYPES[name]
    if record.type != expected:
        raise ValueError(f"a message has the type {record.type} instead of {expected}; it is of another version")
    return decoded(record.data, record.type)


class ReplayedMessage(NamedTuple):
    """A message for the twin."""

    name: str  # of its topic, relative
    record: Record
    message: Any  # decoded


def messages_in_order(run: RecordedRun, names: Collection[str], troubles: Counter[str]) -> Iterator[ReplayedMessage]:
    """Messages for the twin, which needs commands before the samples that count them, and samples by tick.

    Recorders do not keep the order between topics, and other tools not even that within one. Samples are held back
    until `_HELD` others have followed, or the board was reset.

    Parameters
    ----------
    run : RecordedRun
    names : collection of str
        Relative names of topics in `BOARD_TOPICS`.
    troubles : Counter
        Collects what is left out, and why.
    """
    order = SampleOrder()
    held: list[tuple[float, ReplayedMessage]] = []  # by the first tick
    released = -math.inf  # last tick
    for name, record in run.records(*names):
        try:
            item = ReplayedMessage(name, record, message_of(record, name))
            ticks = _ticks(item.message) if name == topics.SNAPSHOT else None
        except ValueError as error:
            troubles[f"{record.topic}: {error}"] += 1
            continue
        if ticks is None:
            if name == topics.WINDING_TEMPERATURES and held:  # belong to the samples before
                held.append((held[-1][0], item))
            else:
                yield item
            continue
        place = order.place(*ticks, record.time_ns)
        if place is Place.RESET:
            yield from (each for _, each in held)
            yield item
            held, released = [], ticks[1]
        elif ticks[0] > released and all(tick != ticks[0] for tick, _ in held):
            insort(held, (ticks[0], item), key=itemgetter(0))
        else:
            troubles["samples out of order or repeated are left out; rosbags-convert sorts a recording"] += 1
        if len(held) > _HELD:
            released, item = held.pop(0)
            yield item
    yield from (each for _, each in held)


def _ticks(message: Any) -> tuple[float, float] | None:
    """First and last tick of a table of samples; None if it has none that can be sorted.

    Raises
    ------
    ValueError
        If it is no table.
    """
    columns, table = snapshot_table(message)
    if "tick" not in columns or not len(table):
        return None
    first, last = table[[0, -1], columns.index("tick")].tolist()
    return (first, last) if math.isfinite(first + last) else None


_TYPES: Final = {topic.name: type_of(topic.message) for topic in BOARD_TOPICS}


def _namespace(path: Path, seen: Counter[str], wanted: str) -> str:
    boards = [
        namespace
        for topic in seen
        if (namespace := topic.removesuffix(f"/{topics.SNAPSHOT}")) != topic
        and f"{namespace}/{topics.RESIDUAL}" not in seen
    ]
    if wanted:
        wanted = topics.within("/", wanted) if wanted.startswith("/") else f"/{wanted.strip('/')}"
        boards = [name for name in boards if name == wanted]
    if not boards:
        names = ", ".join(sorted(seen)[:20]) or "no messages"
        where = f"{wanted or DEFAULT_NAMESPACE}/{topics.SNAPSHOT}"
        raise RunError(
            f"{path} contains no telemetry of a board ({where}) but {names}; record all topics of the bridge"
        )
    if len(boards) > 1 and DEFAULT_NAMESPACE not in boards:
        raise RunError(f"{path} contains the boards {', '.join(boards)}; choose one with --namespace")
    return DEFAULT_NAMESPACE if DEFAULT_NAMESPACE in boards else boards[0]
