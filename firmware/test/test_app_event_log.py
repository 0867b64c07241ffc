"""The console of the board: events with their ticks."""

from __future__ import annotations

import re

import pytest
from core_library import Core
from freemaster_model import parse_answer, request
from servo_bench import VARIABLES, Bench

PIPE = 0x28


class Console:
    """A client that reads lines."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._port, self._received = 1, 0

    def poll(self) -> bytes:
        """Text of one answer."""
        self._bench.core.lib.servo_background(self._bench.servo)
        hal, wire = self._bench.hal, request(PIPE, bytes([self._port, self._received]))
        hal.serial_in[0 : len(wire)] = wire
        hal.serial_in_taken, hal.serial_in_size, hal.serial_out_size = 0, len(wire), 0
        self._bench.core.lib.servo_background(self._bench.servo)
        answer = parse_answer(bytes(hal.serial_out[0 : hal.serial_out_size]))
        self._port, self._received = self._port ^ 0x80, len(answer.data) - 2
        return answer.data[2:]

    def lines(self) -> list[str]:
        """All available lines without their ticks, which must increase."""
        text = b""
        while part := self.poll() or self.poll():  # one answer acknowledges, the next one contains the following text
            text += part
        ticks, lines = [], []
        for line in text.decode("ascii").splitlines():
            found = re.fullmatch(r"(\d+) (\S.*)", line)
            assert found, line
            ticks.append(int(found[1]))
            lines.append(found[2])
        assert ticks == sorted(ticks)
        assert not ticks or ticks[-1] <= self._bench.servo.tick
        return lines


@pytest.fixture
def quiet(core: Core) -> Bench:
    """A board that has just entered STOP."""
    bench = Bench(core)
    bench.to_stop()
    return bench


def test_reset_and_states_are_logged(quiet: Bench) -> None:
    console = Console(quiet)
    assert console.lines() == ["reset", "axis1 INIT", "axis2 INIT", "axis1 STOP", "axis2 STOP"]
    quiet.to_spin(1)
    lines = console.lines()
    assert lines[0] == "axis2 RUN/CALIB"
    assert lines[-1] == "axis2 RUN/SPIN"
    assert lines.index("axis2 RUN/READY") < lines.index("axis2 RUN/ALIGN")
    assert console.lines() == [], "no line is repeated, and none without an event"


def test_faults_are_logged_by_name(quiet: Bench) -> None:
    console = Console(quiet)
    console.lines()
    quiet.hal.axis[0].over_current = True
    quiet.core.lib.servo_over_current_isr(quiet.servo, 0)
    quiet.slow(2)
    assert console.lines() == ["axis1 fault OVER_CURRENT", "axis1 FAULT"]
    quiet.hal.axis[0].over_current = False
    quiet.clear(0)
    quiet.slow(300)
    assert console.lines()[:2] == ["axis1 faults cleared", "axis1 INIT"]


def test_refused_writes_and_points_are_logged(quiet: Bench) -> None:
    console = Console(quiet)
    console.lines()
    address = quiet.address("param.acceleration_limit", 1)
    assert quiet.core.lib.servo_write(quiet.servo, address, b"\x00" * 4, 4) == 0x97
    points = bytes(16)
    assert quiet.core.lib.servo_write(quiet.servo, quiet.address("cmd.points"), points, 16) == 0x97
    quiet.slow()
    assert console.lines() == ["refused param.acceleration_limit", "points refused: MODE"]


def test_a_reset_by_the_watchdog_is_logged(core: Core) -> None:
    bench = Bench(core)
    bench.hal.reset_by_watchdog = True
    core.lib.servo_init(bench.servo, bench.hal, core.lib.probe_config())
    assert Console(bench).lines() == ["reset by the watchdog"]


def test_oldest_events_are_discarded_and_counted(quiet: Bench) -> None:
    console = Console(quiet)
    console.lines()
    names, sizes = ("param.host_timeout", "param.acceleration_limit"), (2, 4)
    events = 40
    for number in range(events):
        quiet.core.lib.servo_write(quiet.servo, quiet.address(names[number % 2]), bytes(4), sizes[number % 2])
    lines = console.lines()
    lost = int(lines[0].removeprefix("lost before: "))
    assert lines[1:] == [f"refused {names[number % 2]}" for number in range(lost, events)]
    assert len(lines) > 5


def test_repeated_events_do_not_displace_others(quiet: Bench) -> None:
    console = Console(quiet)
    console.lines()
    quiet.core.lib.servo_write(quiet.servo, quiet.address("param.acceleration_limit"), b"\x00" * 4, 4)
    for _ in range(40):
        quiet.core.lib.servo_write(quiet.servo, quiet.address("param.host_timeout"), b"\x00\x00", 2)
    assert console.lines() == ["refused param.acceleration_limit", "refused param.host_timeout"]


def test_no_line_is_too_long(quiet: Bench) -> None:
    """The longest line of each kind, at the largest tick."""
    console = Console(quiet)
    console.lines()
    log, last = quiet.core.ffi.addressof(quiet.servo, "event_log"), 2**32 - 1
    for variable in quiet.catalogue.variables.values():
        if variable.writable:
            log.tick = last
            quiet.core.lib.event_log_refused(log, quiet.address(variable.name) - VARIABLES)
            assert console.poll().decode("ascii") == f"{last} refused {variable.name}\n"
            assert console.poll() == b""
