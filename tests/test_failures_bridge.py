"""What the shafts do when the bridge, its commander, its cable or its board fails, row by row of
servo_bridge/doc/failures.md.

Board, bridge and user are processes in real time, at three baud rates. One of the boards is of the level `registers`:
a bridge cannot tell, and test_failures_board.py has every rate at both levels. All times are those of the board. Where
there is no bridge any more, a client reads past it all the time: that must not keep a shaft turning.
"""

from __future__ import annotations

import itertools
import math
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, Final

import pytest
from chain import Cable, Chain, Process, User, user
from line_world import BAUDS
from sensor_msgs.msg import JointState
from servo_bridge.freemaster.client import Client
from servo_bridge.freemaster.line import Line
from servo_bridge.wire.serial_port import SerialPort
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.fault_record import FaultRecord, record_variable
from servo_msgs_py.units import PERIOD_NS
from servo_twin.board import Board
from servo_twin.level import Level

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

LEVELS: Final[tuple[Level, ...]] = ("ideal", "registers", "ideal")
COMBINATIONS = list(zip(BAUDS, LEVELS, strict=True))

CATALOGUE = Catalogue.load()
BOTH = ["axis1", "axis2"]
SPIN, STOP, FAULT = (" ".join(f"{axis}={state}" for axis in BOTH) for state in ("RUN/SPIN", "STOP", "FAULT"))
SPEED = 100.0  # rad/s
TIMEOUT = 0.5  # s, param.host_timeout and param.command_timeout after reset
KEEP_ALIVE = 0.1  # s, longest time between two keep-alives
RAMP = SPEED / 4000.0  # s, at param.acceleration_limit after reset
SETTLING = 0.05  # s, for the shaft that trails its ramp
AT_REST = 2.0  # rad/s
HOLDING = 4 * 2.0 * math.pi / 4000  # rad, so far a held shaft moves
HANG = 1.2  # s

Row = dict[str, float]


def seconds(periods: float) -> float:
    """Time of a number of PWM periods; ticks wrap at 32 bits [s]."""
    return (int(periods) & 0xFFFF_FFFF) * PERIOD_NS * 1e-9


@cache
def addresses() -> dict[str, int]:
    """Where the variables are: a client that has to see the first 0.5 s cannot look for them on a slow line."""
    with Board(level="ideal") as board:
        return {name: board.address(name) for name in CATALOGUE.variables}


class Reader:
    """A client that only reads, past the bridge.

    Attributes
    ----------
    rows : list of dict
        What it has seen.
    """

    NAMES: Final = (
        "tick",
        "applied_tick",
        *(f"{axis}.{name}" for axis in BOTH for name in ("position", "speed", "state", "substate", "faults", "limits")),
    )

    def __init__(self, port: SerialPort, baud: int) -> None:
        self._client = Client(Line(port, baud=baud, retries=9))
        self._client.mtu = 254
        self.rows: list[Row] = []

    def look(self) -> Row:
        """Read a snapshot, in which everything is of the same tick."""
        at = addresses()
        first = at["snapshot"]
        data = self._client.read_memory(first, max(at[n] + CATALOGUE[n].size for n in self.NAMES) - first)
        row: dict[str, Any] = {n: CATALOGUE[n].decode(data[at[n] - first :][: CATALOGUE[n].size]) for n in self.NAMES}
        self.rows.append(row)
        return row

    def read(self, name: str) -> Any:
        return CATALOGUE[name].decode(self._client.read_memory(addresses()[name], CATALOGUE[name].size))

    def record(self, axis: int) -> FaultRecord:
        """What an axis has kept of its first fault."""
        name = record_variable(axis)
        size = addresses()["axis2.fault_record"] - addresses()["axis1.fault_record"]
        return FaultRecord.of(axis, self._client.read_memory(addresses()[name], size), CATALOGUE)


class Rig:
    """A board, the bridge before it, and a user who asks both shafts for a speed again and again while he is told to.

    Parameters
    ----------
    chain : Chain
        Nothing in it runs yet.
    me : User
        The user.
    """

    def __init__(self, chain: Chain, me: User) -> None:
        self.chain, self.me = chain, me
        self._commander = me.node.create_timer(1.0 / 20.0, self._ask)
        self._commander.cancel()
        self.board = chain.board()
        self.cable: Cable | None = None
        self.bridge: Process | None = None

    def close(self) -> None:
        self._commander.cancel()
        self.chain.end()
        if self.cable is not None:
            self.cable.pull()

    def _ask(self) -> None:
        self.me.joint_commands.publish(JointState(name=BOTH, velocity=[SPEED, SPEED]))

    # ---- the bridge
    def start_bridge(self, *, cable: bool = False) -> Process:
        """Start a bridge at the port itself or at a cable, and wait until it has its board."""
        if self.cable is not None and not cable:
            self.cable.pull()
            self.cable = None
        elif self.cable is None and cable:
            self.cable = Cable(self.chain.port)
        self.me.messages["/servo/armed"].clear()  # of the bridge before; what is latched may take seconds to arrive
        self.bridge = self.chain.bridge(self.cable.url if self.cable else None, hangs=HANG)
        drained = time.monotonic() + 0.2  # of what the bridge before has still sent; the new one takes longer to start
        self.me.until(lambda: time.monotonic() > drained)
        known = self.mark() + 1
        self.me.until(lambda: self.mark() > known and self.me.matched(), 30.0, "not connected")
        return self.bridge

    def turning(self, *, cable: bool = False) -> Process:
        """Have both shafts turn, by set-points that go on; returns the bridge."""
        if self.bridge is None or not self.bridge.running or cable is (self.cable is None):
            if self.bridge is not None:
                self.bridge.stop()
            self.start_bridge(cable=cable)
        assert self.bridge is not None
        self.hush()
        self.me.seconds(0.02)  # so that the state is the latest one
        if self.state != SPIN or self.me.last("/servo/armed") is not True:
            if self.state == FAULT:
                assert self.me.clear_faults()[0]
            self.me.spinning()
        self.turn()
        return self.bridge

    def turn(self) -> None:
        """Ask for the speed until both shafts have it."""
        self._commander.reset()
        self.me.until(lambda: slowest(self.last) > 0.98 * SPEED, 5.0, "the shafts do not turn")
        reached = self.last["tick"]
        self.me.until(lambda: self.last["applied_tick"] > reached, 5.0, "the set-point is not renewed")

    def hush(self) -> None:
        """Ask for nothing any more."""
        self._commander.cancel()

    def set_timeouts(self, host: float, command: float) -> None:
        """Set both time-outs [s]; set-points end, for they go before parameters and leave a slow line no room."""
        self.hush()
        said = len(self.me.messages["/rosout"])
        done, reason = self.me.set_board_parameters(f"param.host_timeout={host}", f"param.command_timeout={command}")
        assert done, reason
        self.me.until(
            lambda: any("param.command_timeout: " in m.msg for m in self.me.messages["/rosout"][said:]), 15.0, "not set"
        )

    # ---- what is seen
    @property
    def state(self) -> str:
        """States of both axes by the last row of telemetry."""
        return labels(self.last)

    @property
    def exchanges(self) -> float:
        """Time of three long ones on the line [s]."""
        return 3 * 100 * 10 / self.chain.baud

    @property
    def last(self) -> Row:
        """The last row of telemetry."""
        return self.me.rows(len(self.me.messages["/servo/snapshot"]) - 1)[-1]

    def mark(self) -> int:
        """Number of the last snapshot message so far."""
        return len(self.me.messages["/servo/snapshot"]) - 1

    def reader(self, *, cable: bool = False) -> SerialPort:
        """The port for a client past the bridge."""
        return SerialPort(self.cable.url if cable and self.cable else str(self.chain.port), self.chain.baud)

    def watch(self, reader: Reader, condition: Callable[[], bool], within: float = 5.0) -> None:
        """Read until a condition holds, while the user goes on with what he does."""

        def look() -> bool:
            reader.look()
            return condition()

        self.me.until(look, within, "the board past the bridge is not as expected")

    def comes_to_rest(self) -> None:
        """Wait until both shafts have stood for 0.1 s; without a current they run out slowly."""
        start = self.mark() + 1
        self.me.until(
            lambda: self.mark() > start and travel(self.me.rows(self.me.seconds(0.1))) <= HOLDING, 5.0, "no rest"
        )

    def stays(self, duration: float = 0.15) -> None:
        """Nothing moves for a time, whatever is asked."""
        start = self.me.seconds(duration)
        assert travel(self.me.rows(start)) <= HOLDING

    def comes_back_by_command_only(self) -> None:
        """The user goes on asking; faults are cleared, drives enabled, and only a set-point after that moves."""
        armed = len(self.me.messages["/servo/armed"])
        self.stays()
        if self.state == FAULT:
            success, message = self.me.clear_faults()
            assert success, message
            self.me.until(lambda: self.state == STOP, 5.0, "the faults are not cleared")
            self.stays()
        assert not any(m.data for m in self.me.messages["/servo/armed"][armed:])
        assert self.me.last("/servo/armed") is not True
        self.hush()
        self.me.spinning()
        self.comes_to_rest()
        self.stays()
        self.turn()


# ---- rows of what bridge or reader have seen
def slowest(row: Row) -> float:
    return min(abs(row[f"{axis}.speed"]) for axis in BOTH)


def rests(row: Row) -> bool:
    return all(abs(row[f"{axis}.speed"]) < AT_REST for axis in BOTH)


def travel(rows: Sequence[Row]) -> float:
    """How far either shaft has gone from where it was first, at most [rad]."""
    return max(abs(row[f"{axis}.position"] - rows[0][f"{axis}.position"]) for row in rows for axis in BOTH)


def fault_names(row: Row) -> list[list[str]]:
    return [[flag.name for flag in CATALOGUE.active("faults", int(row[f"{axis}.faults"]))] for axis in BOTH]


def labels(row: Row) -> str:
    def label(axis: str) -> str:
        text = CATALOGUE.label("state_t", int(row[f"{axis}.state"]))
        return f"RUN/{CATALOGUE.label('substate_t', int(row[f'{axis}.substate']))}" if text == "RUN" else text

    return " ".join(f"{axis}={label(axis)}" for axis in BOTH)


def expired(row: Row) -> bool:
    return all(
        "EXPIRED" in [flag.name for flag in CATALOGUE.active("limits", int(row[f"{axis}.limits"]))] for axis in BOTH
    )


def stops_after_the_last_set_point(rows: Sequence[Row]) -> None:
    """From the last set-point on the shafts keep their speed for the time-out, and stop then.

    Parameters
    ----------
    rows : sequence of dict
        The last ones of both shafts at speed under control, and what followed until they rested.
    """
    applied = rows[-1]["applied_tick"]  # the board itself says when it took the last command
    after = [(seconds(row["tick"] - applied), row) for row in rows if row["tick"] >= applied]
    before = [row for row in rows if row["tick"] < applied]
    going = [row for since, row in after if since < TIMEOUT - 0.05]
    assert going, "no sample while the shafts went on"
    seen = [(round(since, 3), slowest(row), labels(row), fault_names(row)) for since, row in after]
    assert min(slowest(row) for row in going) == pytest.approx(SPEED, rel=0.1), seen
    first = next(k for k in range(len(after)) if all(rests(row) for _, row in after[k:]))
    gap = max(later - earlier for (earlier, _), (later, _) in itertools.pairwise(after[: first + 1]))
    assert TIMEOUT - 0.01 <= after[first][0] <= TIMEOUT + RAMP + SETTLING + gap
    start, begin = (0.0, after[0][1]) if not before else (seconds(applied - before[-1]["tick"]), before[-1])
    assert travel([begin, *(row for _, row in after)]) <= SPEED * (start + TIMEOUT + RAMP / 2 + 0.01) + HOLDING


def fell_silent(reader: Reader, applied: float) -> None:
    """Both axes have ended by HOST_SILENT, in time."""
    for axis in range(len(BOTH)):
        record = reader.record(axis)
        assert record.fault is not None
        assert record.fault.name == "HOST_SILENT"
        assert TIMEOUT - 0.01 <= seconds(record.tick - applied) <= TIMEOUT + KEEP_ALIVE + 0.02


@pytest.fixture(
    scope="class",
    params=COMBINATIONS,
    ids=lambda value: f"{value[0]}-{value[1]}",
)
def rig(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """What all rows share: every one leaves it so that the next one can go on."""
    baud, level = request.param
    chain = Chain(tmp_path_factory.mktemp("chain"), baud, level=level)
    with user() as me:
        rig = Rig(chain, me)
        try:
            yield rig
        finally:
            rig.close()
            print(chain.logs())


class TestRows:
    """In this order two of three connections serve several rows."""

    def test_publisher_gone(self, rig: Rig) -> None:
        """Of the bridge there is all but set-points."""
        rig.turning(cable=True)
        start = rig.mark()
        rig.hush()
        rig.me.until(lambda: expired(rig.last) and rests(rig.last), 5.0, "the shafts do not stop")
        stops_after_the_last_set_point(rig.me.rows(start))
        rig.me.seconds(0.1)
        rig.stays()
        assert rig.state == SPIN
        assert rig.me.last("/servo/armed") is True
        rig.turn()

    def test_cable_pulled(self, rig: Rig) -> None:
        rig.turning(cable=True)
        assert rig.cable is not None
        before = rig.last
        rig.cable.pull()
        try:
            with rig.reader() as port:
                reader = Reader(port, rig.chain.baud)
                reader.rows.append(before)
                rig.watch(reader, lambda: labels(reader.rows[-1]) == FAULT and rests(reader.rows[-1]))
                stops_after_the_last_set_point(reader.rows)
                assert fault_names(reader.rows[-1]) == [["HOST_SILENT"]] * 2
                fell_silent(reader, reader.rows[-1]["applied_tick"])
                rested = reader.look()
            rig.me.until(lambda: rig.me.last("/servo/state").startswith("DISCONNECTED"))
            assert rig.me.last("/servo/armed") is False
            known = rig.mark() + 1
        finally:
            rig.cable.plug()
        rig.me.until(lambda: rig.mark() >= known, 30.0, "the bridge does not come back")
        assert rig.state == FAULT
        assert travel([rested, *rig.me.rows(known)]) <= HOLDING
        rig.me.until(lambda: "HOST_SILENT" in rig.me.status("servo/servo_bridge: axis1").message)
        rig.comes_back_by_command_only()

    def test_bridge_killed(self, rig: Rig) -> None:
        bridge = rig.turning(cable=True)
        before = rig.last
        bridge.kill()
        with rig.reader(cable=True) as port:
            reader = Reader(port, rig.chain.baud)
            reader.rows.append(before)
            rig.watch(reader, lambda: labels(reader.rows[-1]) == FAULT and rests(reader.rows[-1]))
            stops_after_the_last_set_point(reader.rows)
            assert fault_names(reader.rows[-1]) == [["HOST_SILENT"]] * 2
            fell_silent(reader, reader.rows[-1]["applied_tick"])
            rested = reader.look()
        rig.start_bridge()
        known = rig.mark()
        assert rig.state == FAULT
        assert travel([rested, *rig.me.rows(known)]) <= HOLDING
        rig.comes_back_by_command_only()

    def test_bridge_hung(self, rig: Rig) -> None:
        """Its executor hangs; the thread of its link reads on, and shows afterwards what it has seen."""
        bridge = rig.turning()
        start = rig.mark()
        bridge.send(signal.SIGUSR1)
        rig.me.until(lambda: labels(rig.last) == FAULT and rests(rig.last), HANG + 5.0, "no fault")
        rows = rig.me.rows(start)
        stops_after_the_last_set_point(rows)
        silent = next(row for row in rows if all("HOST_SILENT" in names for names in fault_names(row)))
        assert seconds(silent["tick"] - rows[-1]["applied_tick"]) <= TIMEOUT + KEEP_ALIVE + RAMP + 0.1 + rig.exchanges
        assert fault_names(rows[-1]) == [["HOST_SILENT"]] * 2
        rig.comes_to_rest()
        rig.comes_back_by_command_only()

    def test_bridge_restarted(self, rig: Rig) -> None:
        """The next one comes before the board misses the first one: it stops what it finds moving."""
        bridge = rig.turning()
        try:
            rig.set_timeouts(host=20.0, command=0.0)
            assert rig.state == SPIN, fault_names(rig.last)
            rig.turn()
            before = rig.last
            bridge.kill()
            rig.start_bridge()
            rows = rig.me.rows(rig.mark())
            stop = rows[0]["applied_tick"]  # nothing else is carried out since the stop with which the bridge begins
            ahead = SPEED * (seconds(stop - before["tick"]) + RAMP / 2)
            assert travel([before, rows[-1]]) == pytest.approx(ahead, abs=0.02 * SPEED)
            assert all(rests(row) for row in rows if seconds(row["tick"] - stop) > RAMP + SETTLING)
            rig.me.seconds(0.1)
            rig.stays()
            assert rig.state == SPIN
            assert fault_names(rig.last) == [[], []]
            rig.comes_back_by_command_only()
        finally:
            rig.set_timeouts(host=TIMEOUT, command=TIMEOUT)

    def test_board_power_cycled(self, rig: Rig) -> None:
        rig.turning()
        rig.board.kill()
        rig.me.until(lambda: rig.me.last("/servo/state").startswith("DISCONNECTED"))
        assert rig.me.last("/servo/armed") is False
        known = rig.mark() + 1
        rig.chain.port.unlink()
        rig.board = rig.chain.board(seed=6)
        rig.me.until(lambda: rig.mark() >= known and rig.state == STOP, 30.0, "the bridge does not come back")
        assert travel(rig.me.rows(known)) <= HOLDING
        rig.comes_back_by_command_only()

    def test_bridge_ended(self, rig: Rig) -> None:
        bridge = rig.turning()
        start = rig.mark()
        assert bridge.stop(signal.SIGINT) == 0
        with rig.reader() as port:
            reader = Reader(port, rig.chain.baud)
            rig.watch(reader, lambda: labels(reader.rows[-1]) == STOP)
            assert reader.read("cmd.enable") == [0, 0]
            rested = reader.look()
            end = rested["tick"] + (TIMEOUT + 2 * KEEP_ALIVE) / (PERIOD_NS * 1e-9)
            rig.watch(reader, lambda: reader.rows[-1]["tick"] > end)
            assert labels(reader.rows[-1]) == STOP
            assert fault_names(reader.rows[-1]) == [[], []]
            off = rested["applied_tick"]
        assert travel(reader.rows[reader.rows.index(rested) :]) <= HOLDING
        last = [row for row in rig.me.rows(start) if row["tick"] < off][-1]
        assert seconds(off - last["tick"]) <= 0.5
        bound = SPEED * (seconds(off - last["tick"]) + RAMP / 2 + 0.01)
        assert 0.0 < travel([last, rested]) <= bound + HOLDING
