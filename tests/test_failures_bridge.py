"""Motion of the shafts at failures of bridge, sender, cable or board: the rows of servo_bridge/doc/failures.md.

Board, bridge and user run in real time, at three baud rates. One board has the level `registers`;
test_failures_board.py runs every rate at both levels. All times are board times. Without a bridge, a client reads the
board continuously: that must not keep a shaft turning.
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
from chain import PATIENCE, Cable, Chain, Process, User, ros_user
from diagnostic_msgs.msg import DiagnosticStatus
from line_simulation import BAUDS
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
SETTLING = 0.05  # s, following error of the ramp
AT_REST = 2.0  # rad/s
HOLDING = 4 * 2.0 * math.pi / 4000  # rad, largest motion of a held shaft
HANG = 2.4  # s
BUSY = HANG / 4.0  # s
SIGN_OF_LIFE = 1.0  # s, longest time without one of the executor
SUSPENSION = 5.0  # s

Row = dict[str, float]


def seconds(periods: float) -> float:
    """Time of a difference of ticks, which wrap at 32 bits [s]."""
    return (int(periods) & 0xFFFF_FFFF) * PERIOD_NS * 1e-9


@cache
def addresses() -> dict[str, int]:
    """Addresses of the variables; reading the variable table over a slow line would take longer than 0.5 s."""
    with Board(level="ideal") as board:
        return {name: board.address(name) for name in CATALOGUE.variables}


class Reader:
    """FreeMASTER client beside the bridge that only reads."""

    NAMES: Final = (
        "tick",
        "applied_tick",
        *(f"{axis}.{name}" for axis in BOTH for name in ("position", "speed", "state", "substate", "faults", "limits")),
    )

    def __init__(self, port: SerialPort, baud: int) -> None:
        self._client = Client(Line(port, baud=baud, retries=9))
        self._client.mtu = 254
        self.rows: list[Row] = []  # all snapshots that were read

    def read_snapshot(self) -> Row:
        """Read a snapshot; all values are of the same tick."""
        at = addresses()
        first = at["snapshot"]
        data = self._client.read_memory(first, max(at[n] + CATALOGUE[n].size for n in self.NAMES) - first)
        row: dict[str, Any] = {n: CATALOGUE[n].decode(data[at[n] - first :][: CATALOGUE[n].size]) for n in self.NAMES}
        self.rows.append(row)
        return row

    def read(self, name: str) -> Any:
        return CATALOGUE[name].decode(self._client.read_memory(addresses()[name], CATALOGUE[name].size))

    def record(self, axis: int) -> FaultRecord:
        """Fault record of an axis."""
        name = record_variable(axis)
        size = addresses()["axis2.fault_record"] - addresses()["axis1.fault_record"]
        return FaultRecord.of(axis, self._client.read_memory(addresses()[name], size), CATALOGUE)


class Rig:
    """A board, its bridge, and a user that can send a speed set-point of both axes periodically.

    Parameters
    ----------
    chain : Chain
        Chain without a running process.
    user : User
        ROS client.
    """

    def __init__(self, chain: Chain, user: User) -> None:
        self.chain, self.user = chain, user
        self._speed_timer = user.node.create_timer(1.0 / 20.0, self._send_speed)
        self._speed_timer.cancel()
        self.board = chain.board()
        self.cable: Cable | None = None
        self.bridge: Process | None = None

    def close(self) -> None:
        self._speed_timer.cancel()
        self.chain.end()
        if self.cable is not None:
            self.cable.pull()

    def _send_speed(self) -> None:
        self.user.joint_commands.publish(JointState(name=BOTH, velocity=[SPEED, SPEED]))

    # ---- the bridge
    def start_bridge(self, *, cable: bool = False) -> Process:
        """Start a bridge at the port or at a cable, and wait until it is connected to its board."""
        if self.cable is not None and not cable:
            self.cable.pull()
            self.cable = None
        elif self.cable is None and cable:
            self.cable = Cable(self.chain.port)
        self.user.messages[
            "/servo/armed"
        ].clear()  # of the previous bridge; a latched message may take seconds to arrive
        self.bridge = self.chain.bridge(self.cable.url if self.cable else None, hangs=HANG)
        drained = time.monotonic() + 0.2  # discards messages of the previous bridge; the new one takes longer to start
        self.user.until(lambda: time.monotonic() > drained)
        first = self.last_snapshot_index() + 1
        self.user.until(lambda: self.last_snapshot_index() > first and self.user.matched(), what="not connected")
        return self.bridge

    def start_turning(self, *, cable: bool = False) -> Process:
        """Run both shafts up to `SPEED`, with a connected bridge, which is returned."""
        bridge = self.enabled(cable=cable)
        self.reach_speed()
        return bridge

    def enabled(self, *, cable: bool = False) -> Process:
        """Return a connected bridge with both axes enabled."""
        if self.bridge is None or not self.bridge.running or cable is (self.cable is None):
            if self.bridge is not None:
                self.bridge.stop()
            self.start_bridge(cable=cable)
        assert self.bridge is not None
        self.stop_set_points()
        self.user.wait_board_time(0.02)  # updates `state`
        if self.state != SPIN or self.user.last("/servo/armed") is not True:
            if self.state == FAULT:
                assert self.user.clear_faults()[0]
            self.user.enable_axes()
        return self.bridge

    def reach_speed(self) -> None:
        """Send the speed set-point periodically and wait until both shafts reach it."""
        self._speed_timer.reset()
        self.user.until(lambda: speed_min(self.last) > 0.98 * SPEED, what="the shafts do not turn")
        reached = self.last["tick"]
        self.user.until(lambda: self.last["applied_tick"] > reached, what="the set-point is not renewed")

    def stop_set_points(self) -> None:
        """Stop the periodic set-points."""
        self._speed_timer.cancel()

    def set_timeouts(self, host: float, command: float) -> None:
        """Set both time-outs [s]. Set-points are stopped first: they have priority over parameters on a slow line."""
        self.stop_set_points()
        logged = len(self.user.messages["/rosout"])
        done, reason = self.user.set_board_parameters(f"param.host_timeout={host}", f"param.command_timeout={command}")
        assert done, reason
        self.user.until(
            lambda: any("param.command_timeout: " in m.msg for m in self.user.messages["/rosout"][logged:]),
            15.0,
            "not set",
        )

    # ---- observations
    @property
    def state(self) -> str:
        """States of both axes in the last row of telemetry."""
        return labels(self.last)

    @property
    def exchanges(self) -> float:
        """Time of three exchanges of 100 bytes on the line [s]."""
        return 3 * 100 * 10 / self.chain.baud

    @property
    def last(self) -> Row:
        """The last row of telemetry."""
        return self.user.rows(len(self.user.messages["/servo/snapshot"]) - 1)[-1]

    def last_snapshot_index(self) -> int:
        """Index of the last snapshot message."""
        return len(self.user.messages["/servo/snapshot"]) - 1

    def reader(self, *, cable: bool = False) -> SerialPort:
        """Port for a client beside the bridge."""
        return SerialPort(self.cable.url if cable and self.cable else str(self.chain.port), self.chain.baud)

    def read_until(self, reader: Reader, condition: Callable[[], bool], within: float = PATIENCE) -> None:
        """Read snapshots until a condition holds, while the user node spins."""

        def read_and_check() -> bool:
            reader.read_snapshot()
            return condition()

        self.user.until(read_and_check, within, "the board is not in the expected state")

    def wait_for_standstill(self) -> None:
        """Wait until both shafts have been at rest for 0.1 s; without current they coast."""
        start = self.last_snapshot_index() + 1
        self.user.until(
            lambda: (
                self.last_snapshot_index() > start and travel(self.user.rows(self.user.wait_board_time(0.1))) <= HOLDING
            ),
            5.0,
            "no standstill",
        )

    def assert_standstill(self, duration: float = 0.15) -> None:
        """Both shafts stay at rest for a time [s], with or without set-points."""
        start = self.user.wait_board_time(duration)
        assert travel(self.user.rows(start)) <= HOLDING

    def assert_restart_by_command_only(self) -> None:
        """While set-points continue, faults are cleared and drives enabled; only a later set-point moves a shaft."""
        armed = len(self.user.messages["/servo/armed"])
        self.assert_standstill()
        if self.state == FAULT:
            success, message = self.user.clear_faults()
            assert success, message
            self.user.until(lambda: self.state == STOP, what="the faults are not cleared")
            self.assert_standstill()
        assert not any(m.data for m in self.user.messages["/servo/armed"][armed:])
        # After a hang the middleware is given thousands of messages at once; a lost one is repeated after up to 3 s.
        self.user.until(lambda: self.user.last("/servo/armed") is not True, what="still armed")
        self.stop_set_points()
        self.user.enable_axes()
        self.wait_for_standstill()
        self.assert_standstill()
        self.reach_speed()


# ---- rows of telemetry of the bridge or the reader
def speed_min(row: Row) -> float:
    return min(abs(row[f"{axis}.speed"]) for axis in BOTH)


def is_at_rest(row: Row) -> bool:
    return all(abs(row[f"{axis}.speed"]) < AT_REST for axis in BOTH)


def travel(rows: Sequence[Row]) -> float:
    """Largest distance of either shaft from its first position [rad]."""
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


def assert_stop_after_last_set_point(rows: Sequence[Row]) -> None:
    """After the last set-point the shafts keep their speed for the time-out and then stop.

    Parameters
    ----------
    rows : sequence of dict
        Last rows at speed, and all rows until standstill.
    """
    applied = rows[-1]["applied_tick"]  # tick at which the board applied the last command
    after = [(seconds(row["tick"] - applied), row) for row in rows if row["tick"] >= applied]
    before = [row for row in rows if row["tick"] < applied]
    running = [row for since, row in after if since < TIMEOUT - 0.05]
    assert running, "no sample before the time-out"
    seen = [(round(since, 3), speed_min(row), labels(row), fault_names(row)) for since, row in after]
    assert min(speed_min(row) for row in running) == pytest.approx(SPEED, rel=0.1), seen
    first = next(k for k in range(len(after)) if all(is_at_rest(row) for _, row in after[k:]))
    gap = max(later - earlier for (earlier, _), (later, _) in itertools.pairwise(after[: first + 1]))
    assert TIMEOUT - 0.01 <= after[first][0] <= TIMEOUT + RAMP + SETTLING + gap
    start, begin = (0.0, after[0][1]) if not before else (seconds(applied - before[-1]["tick"]), before[-1])
    assert travel([begin, *(row for _, row in after)]) <= SPEED * (start + TIMEOUT + RAMP / 2 + 0.01) + HOLDING


def assert_host_silent_in_time(reader: Reader, applied: float) -> None:
    """Both axes have the fault HOST_SILENT, within its time-out."""
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
    """Rig shared by all rows; each test leaves it in a state that the next one can use."""
    baud, level = request.param
    chain = Chain(tmp_path_factory.mktemp("chain"), baud, level=level)
    with ros_user() as user:
        rig = Rig(chain, user)
        try:
            yield rig
        finally:
            rig.close()
            print(chain.logs())


class TestRows:
    """In this order two of three connections are used by several rows."""

    def test_publisher_gone(self, rig: Rig) -> None:
        """The bridge runs, but receives no set-points."""
        rig.start_turning(cable=True)
        start = rig.last_snapshot_index()
        rig.stop_set_points()
        rig.user.until(lambda: expired(rig.last) and is_at_rest(rig.last), what="the shafts do not stop")
        assert_stop_after_last_set_point(rig.user.rows(start))
        rig.user.wait_board_time(0.1)
        rig.assert_standstill()
        assert rig.state == SPIN
        assert rig.user.last("/servo/armed") is True
        rig.reach_speed()

    def test_cable_pulled(self, rig: Rig) -> None:
        rig.start_turning(cable=True)
        assert rig.cable is not None
        before = rig.last
        rig.cable.pull()
        try:
            with rig.reader() as port:
                reader = Reader(port, rig.chain.baud)
                reader.rows.append(before)
                rig.read_until(reader, lambda: labels(reader.rows[-1]) == FAULT and is_at_rest(reader.rows[-1]))
                assert_stop_after_last_set_point(reader.rows)
                assert fault_names(reader.rows[-1]) == [["HOST_SILENT"]] * 2
                assert_host_silent_in_time(reader, reader.rows[-1]["applied_tick"])
                stopped = reader.read_snapshot()
            rig.user.until(lambda: rig.user.link_level() == DiagnosticStatus.ERROR)
            assert rig.user.last("/servo/armed") is False
            first = rig.last_snapshot_index() + 1
        finally:
            rig.cable.plug()
        rig.user.until(lambda: rig.last_snapshot_index() >= first, what="the bridge does not come back")
        assert rig.state == FAULT
        assert travel([stopped, *rig.user.rows(first)]) <= HOLDING
        rig.user.until(lambda: "HOST_SILENT" in rig.user.status("servo/servo_bridge: axis1").message)
        rig.assert_restart_by_command_only()

    def test_bridge_killed(self, rig: Rig) -> None:
        bridge = rig.start_turning(cable=True)
        before = rig.last
        bridge.kill()
        with rig.reader(cable=True) as port:
            reader = Reader(port, rig.chain.baud)
            reader.rows.append(before)
            rig.read_until(reader, lambda: labels(reader.rows[-1]) == FAULT and is_at_rest(reader.rows[-1]))
            assert_stop_after_last_set_point(reader.rows)
            assert fault_names(reader.rows[-1]) == [["HOST_SILENT"]] * 2
            assert_host_silent_in_time(reader, reader.rows[-1]["applied_tick"])
            stopped = reader.read_snapshot()
        rig.start_bridge()
        first = rig.last_snapshot_index()
        assert rig.state == FAULT
        assert travel([stopped, *rig.user.rows(first)]) <= HOLDING
        rig.assert_restart_by_command_only()

    def test_bridge_busy(self, rig: Rig) -> None:
        """The executor is blocked for longer than the timeouts, but less than a second: the link feeds the board."""
        assert TIMEOUT < BUSY < SIGN_OF_LIFE
        bridge = rig.start_turning()
        start = rig.last_snapshot_index()
        bridge.send(signal.SIGUSR2)
        rig.user.wait_board_time(BUSY + 1.0)
        rows = rig.user.rows(start)
        assert fault_names(rows[-1]) == [[], []]
        assert rig.state == SPIN
        rig.stop_set_points()

    def test_bridge_hung(self, rig: Rig) -> None:
        """The executor is blocked; the link thread continues to read, and publishes its samples afterwards."""
        bridge = rig.start_turning()
        start = rig.last_snapshot_index()
        bridge.send(signal.SIGUSR1)
        rig.user.until(lambda: labels(rig.last) == FAULT and is_at_rest(rig.last), what="no fault")
        rows = rig.user.rows(start)
        assert_stop_after_last_set_point(rows)
        silent = next(row for row in rows if all("HOST_SILENT" in names for names in fault_names(row)))
        limit = SIGN_OF_LIFE + TIMEOUT + 2 * KEEP_ALIVE + RAMP + 0.1 + rig.exchanges
        # From the last command: the signal may reach the bridge late.
        assert seconds(silent["tick"] - rows[-1]["applied_tick"]) <= limit
        assert fault_names(rows[-1]) == [["HOST_SILENT"]] * 2
        rig.wait_for_standstill()
        rig.assert_restart_by_command_only()

    def test_bridge_suspended(self, rig: Rig) -> None:
        """All threads stand still; the link survives, because the board was not reset."""
        bridge = rig.start_turning()
        states = len(rig.user.messages["/servo/state"])
        applied = rig.last["applied_tick"]
        bridge.send(signal.SIGSTOP)
        try:
            time.sleep(1.2 * SUSPENSION)  # the board may be late itself
        finally:
            bridge.send(signal.SIGCONT)
        rig.user.until(lambda: labels(rig.last) == FAULT and is_at_rest(rig.last), what="no fault")
        assert fault_names(rig.last) == [["HOST_SILENT"]] * 2
        assert seconds(rig.last["tick"] - applied) > 0.9 * SUSPENSION
        rig.wait_for_standstill()
        assert not any("DISCONNECTED" in m.data for m in rig.user.messages["/servo/state"][states:])
        rig.assert_restart_by_command_only()

    def test_bridge_restarted(self, rig: Rig) -> None:
        """A new bridge that connects before the host time-out stops moving axes."""
        bridge = rig.enabled()
        try:
            rig.set_timeouts(host=20.0, command=0.0)
            assert rig.state == SPIN, fault_names(rig.last)
            rig.reach_speed()
            before = rig.last
            bridge.kill()
            rig.start_bridge()
            rows = rig.user.rows(rig.last_snapshot_index())
            stop = rows[0]["applied_tick"]  # the stop at the connection is the last applied command
            ahead = SPEED * (seconds(stop - before["tick"]) + RAMP / 2)
            assert travel([before, rows[-1]]) == pytest.approx(ahead, abs=0.02 * SPEED)
            assert all(is_at_rest(row) for row in rows if seconds(row["tick"] - stop) > RAMP + SETTLING)
            rig.user.wait_board_time(0.1)
            rig.assert_standstill()
            assert rig.state == SPIN
            assert fault_names(rig.last) == [[], []]
            rig.assert_restart_by_command_only()
        finally:
            rig.set_timeouts(host=TIMEOUT, command=TIMEOUT)

    def test_board_power_cycled(self, rig: Rig) -> None:
        rig.start_turning()
        rig.board.kill()
        rig.user.until(lambda: rig.user.link_level() == DiagnosticStatus.ERROR)
        assert rig.user.last("/servo/armed") is False
        first = rig.last_snapshot_index() + 1
        rig.chain.port.unlink()
        rig.board = rig.chain.board(seed=6)
        rig.user.until(
            lambda: rig.last_snapshot_index() >= first and rig.state == STOP, 30.0, "the bridge does not come back"
        )
        assert travel(rig.user.rows(first)) <= HOLDING
        rig.assert_restart_by_command_only()

    def test_bridge_ended(self, rig: Rig) -> None:
        bridge = rig.start_turning()
        start = rig.last_snapshot_index()
        assert bridge.stop(signal.SIGINT) == 0
        with rig.reader() as port:
            reader = Reader(port, rig.chain.baud)
            rig.read_until(reader, lambda: labels(reader.rows[-1]) == STOP)
            assert reader.read("cmd.enable") == [0, 0]
            stopped = reader.read_snapshot()
            end = stopped["tick"] + (TIMEOUT + 2 * KEEP_ALIVE) / (PERIOD_NS * 1e-9)
            rig.read_until(reader, lambda: reader.rows[-1]["tick"] > end)
            assert labels(reader.rows[-1]) == STOP
            assert fault_names(reader.rows[-1]) == [[], []]
            off = stopped["applied_tick"]
        assert travel(reader.rows[reader.rows.index(stopped) :]) <= HOLDING
        last = [row for row in rig.user.rows(start) if row["tick"] < off][-1]
        assert seconds(off - last["tick"]) <= 0.5
        bound = SPEED * (seconds(off - last["tick"]) + RAMP / 2 + 0.01)
        assert 0.0 < travel([last, stopped]) <= bound + HOLDING
