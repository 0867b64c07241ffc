"""What an axis is for: every mode, feature and limit, and all ways in and out."""

from __future__ import annotations

from targets.rig import Rig
from targets.scenarios.parts import INT16, INT32, POSITION, SPEED, TORQUE, features, ready, spin, stop


def start_to_stop(rig: Rig) -> None:
    """Power-on, rotor search, a move in each mode under load, ramp down, free wheel, STOP."""
    spin(rig)
    rig.set("cmd.position", 1.0, -3.0)
    rig.run(0.05)
    rig.load(0, 0.03)
    rig.run(0.01)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 150.0, 0.0)
    rig.set("cmd.i_q", 0.0, -0.3)
    rig.run(0.04)
    rig.load(0, 0.0)
    stop(rig)
    rig.run(0.004)


def second_thoughts(rig: Rig) -> None:
    """Off and on again in every sub-state that has a way back."""
    ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("CALIB on both axes", lambda: rig.places() == ["CALIB", "CALIB"])
    stop(rig)
    rig.set("cmd.enable", 1)
    rig.until("ALIGN on both axes", lambda: rig.places() == ["ALIGN", "ALIGN"])
    stop(rig)
    spin(rig)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0, -40.0)
    rig.set("cmd.mode", SPEED)
    rig.run(0.02)
    rig.set("cmd.enable", 0)
    rig.run(0.005)
    rig.set("cmd.enable", 1)
    rig.set("cmd.speed", -40.0, 60.0)
    rig.run(0.03)
    rig.set("cmd.enable", 0)
    rig.until("FREEWHEEL", lambda: rig.places()[0] == "FREEWHEEL")
    rig.set("cmd.enable", 1)
    rig.until("ALIGN from FREEWHEEL", lambda: rig.places()[0] == "ALIGN")
    stop(rig)


def once_more(rig: Rig) -> None:
    """A second alignment, which leaves the turns as they are; the other axis is off."""
    ready(rig)
    for _ in range(2):
        rig.set("cmd.enable", 1, 0)
        rig.until("SPIN on axis 1", lambda: rig.places()[0] == "SPIN")
        rig.set("cmd.enable", 0)
        rig.until("STOP", lambda: rig.places()[0] == "STOP")


def extremes(rig: Rig) -> None:
    """Top speed both ways, set-points and limits at the ends of their numbers, limits that change on the way."""
    spin(rig)
    rig.set("param.acceleration_limit", 50_000.0)
    rig.set_raw("param.speed_limit", INT32[1], INT32[1])
    rig.set("cmd.mode", SPEED)
    rig.set_raw("cmd.speed", INT32[1], INT32[0])
    rig.run(0.05)
    rig.set_raw("cmd.speed", INT32[0], INT32[1])
    rig.run(0.06)
    rig.set_raw("cmd.mode", TORQUE, POSITION)
    rig.set_raw("cmd.i_q", INT16[0], INT16[1])
    rig.set_raw("cmd.position", INT32[1], INT32[0])
    rig.run(0.02)
    rig.set_raw("param.i_q_limit", 0, INT16[1])
    rig.set("param.speed_limit", 50.0)
    rig.run(0.02)
    rig.set_raw("cmd.position", 0, INT32[1])
    rig.set_raw("param.i_q_limit", INT16[1], 1000)
    rig.run(0.02)


def forward(rig: Rig) -> None:
    """Friction, speed and acceleration fed forward, together and alone; a shaft left behind, and a shaft too fast."""
    spin(rig)
    rig.set("param.features", features("FRICTION", "SPEED_FORWARD", "ACCELERATION_FORWARD"), features("FRICTION"))
    rig.set("cmd.position", 2.0, -2.0)
    rig.run(0.05)
    rig.set("param.features", features("SPEED_FORWARD", "SPEED_OBSERVER"), features("ACCELERATION_FORWARD"))
    rig.set("cmd.mode", POSITION, SPEED)
    rig.set("cmd.speed", 0.0, 100.0)
    rig.set("cmd.position", 0.0)
    rig.run(0.03)
    rig.set("param.features", features("SPEED_FORWARD", "FOLLOWING_ERROR"), features("OVER_SPEED"))
    rig.set("param.following_error", 0.5)
    rig.set("param.over_speed", 150.0)
    rig.lock(0)
    rig.set("cmd.position", 10.0)
    rig.set("cmd.speed", 0.0, 200.0)
    rig.until("left behind", lambda: "FOLLOWING_ERROR" in rig.faults(0))
    rig.until("too fast", lambda: "OVER_SPEED" in rig.faults(1))
    rig.set_raw("param.following_error", *INT32)
    rig.set_raw("param.over_speed", *INT32)
    rig.run(0.001)


def soft_limits(rig: Rig) -> None:
    """Both soft limits, reached in each mode, and limits at the ends of their numbers."""
    spin(rig)
    rig.set("param.features", features("POSITION_LIMITS"))
    rig.set("param.position_min", -0.5)
    rig.set("param.position_max", 0.5)
    rig.set("cmd.position", 3.0, -3.0)
    rig.run(0.06)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", -100.0, 0.0)
    rig.set("cmd.i_q", 0.0, 0.5)
    rig.run(0.05)
    rig.set("param.position_min", 0.3)  # behind the one, before the other shaft
    rig.set("cmd.mode", POSITION)
    rig.set("cmd.position", -1.0, 1.0)
    rig.run(0.03)
    rig.set_raw("param.position_min", *INT32)
    rig.set_raw("param.position_max", *reversed(INT32))
    rig.set("cmd.position", 0.2)
    rig.run(0.02)
    rig.set("param.features", features())
    rig.run(0.002)
