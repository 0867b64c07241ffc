"""Recordings of a virtual board over its serial line: samples belong to the reported ticks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_bridge.freemaster.frames import Answer, AnswerParser, decode_uleb, encode_request, encode_uleb
from servo_msgs_py.catalogue import AXES, Variable
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS
from servo_twin.board import Board
from servo_twin.simulation import enable

BAUD: Final = 1_000_000.0
TICK_NS: Final = SLOW_PERIODS * PERIOD_NS
READ, WRITE, COMMAND, SET, GET = 0x21, 0x23, 0x30, 0x24, 0x25
CHUNK: Final = 240
FAST, SLOW = 0, 1
UNSIGNED, SIGNED = 1, 2
ABOVE: Final = 0x10
RUNNING, FULL = 2, 4


@dataclass(frozen=True)
class Trigger:
    """Rising edge of a variable at a raw threshold."""

    name: str
    value: int


class Host:
    """Client of the recorders with its own frames."""

    def __init__(self, board: Board) -> None:
        self.board = board

    def ask(self, command: int, payload: bytes = b"", size: int = 0) -> Answer:
        """One request and its answer."""
        frame = encode_request(command, payload)
        assert self.board.serial_in(frame) == len(frame)
        parser, answer = AnswerParser(size), None
        while answer is None:
            self.board.advance(self.board.serial_next_ns() or self.board.time_ns + PERIOD_NS)
            answer = parser.feed(self.board.serial_out())
        return answer

    def write(self, name: str, values: Sequence[float]) -> None:
        """Write a variable in SI units."""
        data = self.board.catalogue[name].encode(values)
        payload = b"\0" + encode_uleb(self.board.address(name)) + encode_uleb(len(data)) + data
        assert self.ask(WRITE, payload).status == 0

    def start(
        self, recorder: int, names: Sequence[str], total: int = 0, before: int = 0, trigger: Trigger | None = None
    ) -> None:
        """Record variables."""
        slots = [(name, b"\0\0") for name in names]
        if trigger is not None:
            slots.append((trigger.name, bytes([UNSIGNED | ABOVE | 4]) + encode_uleb(trigger.value)))
        self.set(recorder, 1, bytes([len(slots)]) + b"".join(map(encode_uleb, (total, before, 0))))
        for k, (name, condition) in enumerate(slots):
            size = self.variable(name).size
            self.set(recorder, 2, bytes([k]) + encode_uleb(self.board.address(name)) + bytes([size]) + condition)
        self.set(recorder, 3)

    def set(self, recorder: int, operation: int, data: bytes = b"") -> None:
        """SETREC with one operation."""
        assert self.ask(SET, bytes([recorder, operation, len(data)]) + data).status == 0

    def state(self, recorder: int) -> int:
        """GETREC STATUS."""
        return self.ask(GET, bytes([recorder, 0x84])).data[0]

    def samples(self, recorder: int, names: Sequence[str]) -> Mapping[str, NDArray[np.int64]]:
        """Points in the order of time, as raw numbers by name."""
        info = self.ask(GET, bytes([recorder, 0x83])).data
        numbers, at = [], 2
        while at < len(info):
            number, at = decode_uleb(info, at)
            numbers.append(number)
        address, size, count, first = numbers
        data = b"".join(
            self.ask(READ, encode_uleb(address + at) + encode_uleb(part), part).data
            for at in range(0, size * count, CHUNK)
            for part in (min(CHUNK, size * count - at),)
        )
        variables = [self.variable(name) for name in names]
        dtype = np.dtype([(v.name, f"<{'i' if v.format.signed else 'u'}{v.size}") for v in variables])
        assert dtype.itemsize == size
        points = np.roll(np.frombuffer(data, dtype), -first)
        return {name: points[name].astype(np.int64) for name in names}

    def variable(self, name: str) -> Variable:
        """Variable of the catalogue."""
        return self.board.catalogue[name]


@pytest.fixture(params=["ideal", "registers"])
def host(request: pytest.FixtureRequest) -> Iterator[Host]:
    """Host of a board with both axes in torque mode at zero."""
    with Board(level=request.param, baud=BAUD, seed=3) as board:
        enable(board)
        board.write("cmd.mode", [board.catalogue.enums["control_mode_t"]["TORQUE"]] * AXES)
        board.run(0.02)
        yield Host(board)
        assert board.read_raw("late_loops") == [0]


STEP: Final = ("tick", "axis1.i_q", "axis1.i_q_ref", "axis2.i_q", "axis2.i_q_ref", "axis1.i_a", "axis1.duty_a")


def test_step_of_the_current_at_the_rate_of_the_loop(host: Host) -> None:
    """Trigger position, one sample per period, and the same numbers as the telemetry of the same tick."""
    board = host.board
    one_ampere = round(1.0 / host.variable("axis1.i_q").lsb)
    host.start(FAST, STEP, total=200, before=60, trigger=Trigger("axis1.i_q_ref", one_ampere // 2))
    assert host.ask(READ, encode_uleb(0x0040_0000) + b"\x04", 4).status == 0x89, "not while it records"
    board.run(200 * PERIOD_NS * 1e-9)
    host.write("cmd.i_q", [1.0, -1.0])
    log = board.record(board.time_ns + 40 * TICK_NS)
    assert host.state(FAST) == FULL
    points = host.samples(FAST, STEP)

    ticks = points["tick"]
    assert (np.diff(ticks) == 1).all()
    assert len(ticks) == 200
    assert points["axis1.i_q_ref"][59] == 0
    assert points["axis1.i_q_ref"][60] == pytest.approx(one_ampere, abs=1)
    for axis in (1, 2):  # within 1 ms at 90 % of it
        i_q, i_q_ref = points[f"axis{axis}.i_q"], points[f"axis{axis}.i_q_ref"]
        reached = int(np.argmax(np.abs(i_q) > 0.9 * abs(i_q_ref[-1])))
        assert 60 < reached < 60 + 16
        assert np.mean(i_q[100:]) == pytest.approx(i_q_ref[-1], abs=0.05 * one_ampere)
    assert np.ptp(points["axis1.i_a"]) > 0.1 * one_ampere
    assert np.ptp(points["axis1.duty_a"]) > 0

    by_tick = {int(tick): k for k, tick in enumerate(ticks)}
    rows = [row for row in log if int(row["tick"]) in by_tick]
    assert len(rows) >= 10
    for row in rows:
        k = by_tick[int(row["tick"])]
        assert [int(row[f"axis{axis}.i_q"]) for axis in (1, 2)] == [points[f"axis{axis}.i_q"][k] for axis in (1, 2)]


def test_command_triggers_at_its_tick(host: Host) -> None:
    """The trigger is at the tick in which the command takes effect."""
    board = host.board
    names = ("tick", "axis2.event_command", "axis2.event_mode", "axis2.mode")
    host.start(FAST, names, total=60, before=20, trigger=Trigger("axis2.event_mode", 1))
    board.run(0.02)
    host.write("cmd.i_q", [0.1, 0.0])
    board.run(0.05)
    assert host.state(FAST) == RUNNING, "another axis, and another event"
    host.write("cmd.mode", [2, 1])
    board.run(0.02)
    assert host.state(FAST) == FULL
    points = host.samples(FAST, names)
    applied = board.read_raw("applied_tick")[0]
    assert points["tick"][20] == applied
    assert list(points["axis2.mode"][18:22]) == [2, 2, 1, 1]
    assert list(points["axis2.event_command"][18:22]) == [0, 0, 64, 64]


def test_fault_triggers_the_recorder(host: Host) -> None:
    """Samples before and after the first fault; the state changes in the next period."""
    board = host.board
    names = ("tick", "axis1.first_fault", "axis1.event_state", "axis1.i_q")
    host.write("param.host_timeout", [0.05])
    host.start(FAST, names, total=100, before=50, trigger=Trigger("axis1.first_fault", 1))
    assert host.ask(COMMAND, b"\x04").status == 0  # last keep-alive
    assert host.ask(0x31, size=1).status == 0
    board.run(0.4)
    assert board.read_raw("axis1.first_fault")[0] == 7
    assert host.state(FAST) == FULL
    points = host.samples(FAST, names)
    assert list(points["axis1.first_fault"][48:52]) == [0, 0, 7, 7]
    assert points["axis1.event_state"][49] == 0
    record = board.read_memory(board.address("axis1.fault_record"), 8)
    assert int.from_bytes(record[4:8], "little") in (points["tick"][50], points["tick"][49])


def test_slow_recorder_agrees_with_the_telemetry(host: Host) -> None:
    """The slow recorder samples with the snapshot: all numbers of both axes are of the same tick."""
    board = host.board
    names = ("tick", "axis1.speed", "axis2.speed", "axis1.i_q", "axis2.i_q", "axis1.position", "axis1.u_q")
    host.write("cmd.i_q", [0.5, 0.4])
    host.start(SLOW, names)
    log = board.record(board.time_ns + 50 * TICK_NS)
    assert host.ask(SET, bytes([FAST, 1, 4, 1, 0, 0, 0])).status == 0x87, "only one recorder at a time"
    host.set(SLOW, 4)
    points = host.samples(SLOW, names)
    assert (np.diff(points["tick"]) == SLOW_PERIODS).all()
    common = [k for k, tick in enumerate(points["tick"]) if int(tick) in set(map(int, log["tick"]))]
    assert len(common) >= 45
    rows = log[np.isin(log["tick"], points["tick"])]
    for name in names:
        assert (points[name][common] == rows[name]).all(), name
    assert np.ptp(points["axis1.speed"]) > 0
