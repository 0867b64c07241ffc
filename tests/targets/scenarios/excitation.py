"""Current vector at an imposed angle, and test signals on every set-point."""

from __future__ import annotations

from typing import Final

from servo_msgs_py.catalogue import Catalogue

from targets.rig import Rig
from targets.scenarios.parts import SPEED, TEST, TORQUE, features, ready, spin, stop

_POINT: Final = Catalogue.load().enums["test_point_t"]


def _signal(rig: Rig, first: str, second: str, step: float, growth: float, calls: int) -> None:
    rig.set("cmd.test_amplitude", 0.02)
    rig.set("cmd.test_step", step)
    rig.set("cmd.test_growth", growth)
    rig.set("cmd.test_calls", calls)
    rig.set_raw("cmd.test_point", _POINT[first], _POINT[second])


def _to_test(rig: Rig) -> None:
    rig.set_raw("cmd.mode", TEST, TEST)
    rig.set("cmd.enable", 1)
    rig.until("TEST", lambda: rig.states() == ["TEST", "TEST"])


def imposed(rig: Rig) -> None:
    """A rotating vector: limits of speed, current and position, an expired set-point, stops at low and high speed."""
    ready(rig)
    _to_test(rig)
    rig.set("cmd.i_q", 1.0, 4.0)
    rig.set("param.i_q_limit", 3.0)
    rig.run(0.05)
    _signal(rig, "I_D", "I_Q", 0.005, 0.003, 640)
    rig.run(0.06)
    rig.set("cmd.speed", 10.0, -400.0)
    rig.set("param.speed_limit", 300.0, 20.0)
    rig.run(0.03)
    rig.set("param.position_max", 0.05, 100.0)
    rig.set_raw("param.features", features("POSITION_LIMITS"), features())
    rig.set("cmd.speed", 10.0, -400.0)
    rig.run(0.05)
    rig.set("param.command_timeout", 0.01)
    rig.run(0.05)
    rig.set("param.command_timeout", 0.0)
    stop(rig)
    _to_test(rig)
    rig.set("param.speed_limit", 419.0)
    rig.set("param.acceleration_limit", 800.0)  # the rotor follows
    rig.set("cmd.i_q", 3.0)
    rig.run(0.1)
    rig.set("cmd.speed", 0.0, -250.0)
    rig.until("above the speed limit for shorting the windings", lambda: rig.get("axis2.speed") < -240.0)
    rig.set_raw("cmd.mode", SPEED, SPEED)
    rig.run(0.05)


def signals(rig: Rig) -> None:
    """Test signals on currents, torque and speed in SPIN; one is aborted, one is requested at an axis that is off."""
    ready(rig)
    _signal(rig, "I_Q", "SPEED", 0.01, 0.0, 100)
    spin(rig)
    rig.set_raw("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 20.0)
    rig.set_raw("param.features", features("ANGLE_CHECK"), features())
    rig.run(0.02)
    _signal(rig, "I_D", "I_Q", 0.01, 0.01, 300)
    rig.run(0.025)
    _signal(rig, "SPEED", "TORQUE", 0.05, 0.1, 60)
    rig.run(0.035)
    _signal(rig, "TORQUE", "I_Q", 0.05, 0.0, 60000)
    rig.run(0.01)
    rig.set_raw("cmd.test_point", _POINT["NONE"], _POINT["I_D"])
    rig.run(0.005)
    rig.set("cmd.enable", 0)
    rig.run(0.02)
