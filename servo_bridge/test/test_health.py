"""Status of the board in /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus
from servo_bridge.freemaster.client import BoardInfo
from servo_bridge.health import Condition, Health
from servo_bridge.telemetry import AxisStatus, Snapshot
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import DEFAULT_JOINTS

SNAPSHOT = Snapshot(8, 0, 0, {"u_dc": 24.0}, 0, 0, (), ())


def status(health: Health, late: int, overruns: int) -> DiagnosticStatus:
    counts = {"late_loops": late, "receiver_overruns": overruns}
    return health.board(BoardInfo(name="servo"), SNAPSHOT, counts)


def test_new_late_loops_and_lost_bytes_are_warnings() -> None:
    health = Health(Catalogue.load(), "bridge", "port", DEFAULT_JOINTS)
    assert status(health, 3, 0).level == DiagnosticStatus.OK, "events before the connection are not reported"
    late = status(health, 5, 0)
    assert (late.level, late.message) == (DiagnosticStatus.WARN, "in the last second: 2 late loops")
    assert {value.key: value.value for value in late.values}["late loops"] == "5"
    lost = status(health, 5, 1)
    assert (lost.level, lost.message) == (DiagnosticStatus.WARN, "in the last second: 1 receiver overruns")
    assert status(health, 5, 1).level == DiagnosticStatus.OK


def test_counters_that_have_not_been_read_are_unknown() -> None:
    found = Health(Catalogue.load(), "bridge", "port", DEFAULT_JOINTS).board(BoardInfo(name="servo"), SNAPSHOT)
    assert {value.key: value.value for value in found.values}["late loops"] == "unknown"


def test_late_loops_are_counted_across_the_wrap_of_the_counter() -> None:
    health = Health(Catalogue.load(), "bridge", "port", DEFAULT_JOINTS)
    status(health, 0xFFFF, 0)
    assert status(health, 1, 0).message == "in the last second: 2 late loops"


def axis_status(condition: Condition | None, limit: float | None, faults: int = 0) -> DiagnosticStatus:
    values = {"axis1.position": 0.0, "axis1.speed": 0.0, "axis1.i_q": 2.0}
    state = AxisStatus("RUN/SPIN", accepts_set_points=True)
    snapshot = Snapshot(8, 0, 0, values, 0, 0, (state, state), (faults, 0))
    return Health(Catalogue.load(), "bridge", "port", DEFAULT_JOINTS).axis(0, snapshot, None, condition, limit)


def test_hot_winding_is_a_warning_with_the_derated_current() -> None:
    cool = axis_status(Condition(80.0, 8.25, 0.0), 4.0)
    assert (cool.level, cool.message) == (DiagnosticStatus.OK, "RUN/SPIN")
    about = {value.key: value.value for value in cool.values}
    assert (about["winding [deg C]"], about["current limit left [%]"]) == ("80", "100")
    hot = axis_status(Condition(115.0, 3.0, 0.0), 4.0)
    assert (hot.level, hot.message) == (DiagnosticStatus.WARN, "RUN/SPIN; hot winding: current limit derated to 75 %")
    assert axis_status(Condition(115.0, 3.0, 0.0), 2.5).level == DiagnosticStatus.OK, (
        "limited by the host, not by temperature"
    )
    mask = Catalogue.load().flag("faults", "MOTOR_TEMPERATURE").mask
    assert axis_status(Condition(145.0, 2.0, 0.0), 4.0, mask).level == DiagnosticStatus.ERROR


def test_an_oscillation_is_a_warning_with_its_frequency() -> None:
    found = axis_status(Condition(40.0, 8.25, 236.0), 4.0)
    assert (found.level, found.message) == (DiagnosticStatus.WARN, "RUN/SPIN; oscillation at 236 Hz")
    quiet = axis_status(Condition(40.0, 8.25, 0.0), 4.0)
    texts = [{value.key: value.value for value in status.values}["oscillation [Hz]"] for status in (found, quiet)]
    assert texts == ["236", "0"]
    assert quiet.level == DiagnosticStatus.OK
    stopped = axis_status(Condition(40.0, 8.25, 236.0), 4.0, Catalogue.load().flag("faults", "OSCILLATION").mask)
    assert stopped.level == DiagnosticStatus.ERROR
    assert "236 Hz" in stopped.message


def test_a_winding_that_has_not_been_read_is_not_shown() -> None:
    status = axis_status(None, None)
    assert status.level == DiagnosticStatus.OK
    assert "winding [deg C]" not in {value.key for value in status.values}


def test_active_inputs_are_shown_if_they_are_in_the_telemetry() -> None:
    health = Health(Catalogue.load(), "bridge", "port", DEFAULT_JOINTS)
    values = {"axis1.position": 0.0, "axis1.speed": 0.0, "axis1.i_q": 0.0}
    axes = (AxisStatus("STOP", accepts_set_points=False), AxisStatus("STOP", accepts_set_points=False))

    def inputs(**more: float) -> str | None:
        snapshot = Snapshot(
            8, 0, 0, values | {f"axis1.{name}": value for name, value in more.items()}, 0, 0, axes, (0, 0)
        )
        return {value.key: value.value for value in health.axis(0, snapshot).values}.get("inputs")

    assert inputs() is None
    assert inputs(inputs=0.0) == "none"
    assert inputs(inputs=9.0) == "HOME, ENABLE"
