"""What /diagnostics says about the board."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus
from servo_bridge.arbiter import AxisStatus
from servo_bridge.freemaster.client import BoardInfo
from servo_bridge.health import Health
from servo_bridge.telemetry import Frame
from servo_msgs_py.catalogue import Catalogue

FRAME = Frame(8, 0, 0, {"u_dc": 24.0}, 0, 0, (), ())


def status(health: Health, late: int, overruns: int) -> DiagnosticStatus:
    counts = {"late_loops": late, "receiver_overruns": overruns}
    return health.board(BoardInfo(name="servo"), FRAME, counts)


def test_a_late_loop_and_a_lost_byte_are_warnings_when_they_are_new() -> None:
    health = Health(Catalogue.load(), "bridge", "port", ["axis1", "axis2"])
    assert status(health, 3, 0).level == DiagnosticStatus.OK, "what was there before the connection is no news"
    late = status(health, 5, 0)
    assert (late.level, late.message) == (DiagnosticStatus.WARN, "in the last second: 2 late loops")
    assert {value.key: value.value for value in late.values}["late loops"] == "5"
    lost = status(health, 5, 1)
    assert (lost.level, lost.message) == (DiagnosticStatus.WARN, "in the last second: 1 receiver overruns")
    assert status(health, 5, 1).level == DiagnosticStatus.OK


def test_counters_that_have_not_been_read_are_unknown() -> None:
    found = Health(Catalogue.load(), "bridge", "port", ["axis1", "axis2"]).board(BoardInfo(name="servo"), FRAME)
    assert {value.key: value.value for value in found.values}["late loops"] == "unknown"


def test_counters_wrap() -> None:
    health = Health(Catalogue.load(), "bridge", "port", ["axis1", "axis2"])
    status(health, 0xFFFF, 0)
    assert status(health, 1, 0).message == "in the last second: 2 late loops"


def test_the_inputs_of_an_axis_are_named_where_they_are_in_the_telemetry() -> None:
    health = Health(Catalogue.load(), "bridge", "port", ["axis1", "axis2"])
    values = {"axis1.position": 0.0, "axis1.speed": 0.0, "axis1.i_q": 0.0}
    axes = (AxisStatus("STOP", spinning=False), AxisStatus("STOP", spinning=False))

    def said(**more: float) -> str | None:
        frame = Frame(8, 0, 0, values | {f"axis1.{name}": value for name, value in more.items()}, 0, 0, axes, (0, 0))
        return {value.key: value.value for value in health.axis(0, frame).values}.get("inputs")

    assert said() is None
    assert said(inputs=0.0) == "none"
    assert said(inputs=9.0) == "HOME, ENABLE"
