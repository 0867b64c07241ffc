"""Motions in every mode, with every feature and limit, and the starts and stops."""

from __future__ import annotations

from servo_msgs_py.timed_points import TimedPoint, encode_points

from targets.rig import Rig, RigError
from targets.scenarios.parts import FAR, POSITION, SPEED, TORQUE, TRAJECTORY, features, raw_range, ready, spin, stop


def start_to_stop(rig: Rig) -> None:
    """Power-on, rotor search, a move in each mode under load, ramp down, free wheel, STOP."""
    spin(rig)
    rig.set("cmd.position", 1.0, -3.0)
    rig.run(0.05)
    rig.set_load(0, 0.03)
    rig.run(0.01)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 150.0, 0.0)
    rig.set("cmd.i_q", 0.0, -0.3)
    rig.run(0.04)
    rig.set_load(0, 0.0)
    stop(rig)
    rig.run(0.004)


def reenabled(rig: Rig) -> None:
    """Disable and enable again in every sub-state that permits it."""
    ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("CALIB on both axes", lambda: rig.states() == ["CALIB", "CALIB"])
    stop(rig)
    rig.set("cmd.enable", 1)
    rig.until("ALIGN on both axes", lambda: rig.states() == ["ALIGN", "ALIGN"])
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
    rig.until("FREEWHEEL", lambda: rig.states()[0] == "FREEWHEEL")
    rig.set("cmd.enable", 1)
    rig.until("ALIGN from FREEWHEEL", lambda: rig.states()[0] == "ALIGN")
    stop(rig)


def second_alignment(rig: Rig) -> None:
    """A second alignment, which keeps the position; the other axis is off."""
    ready(rig)
    for _ in range(2):
        rig.set("cmd.enable", 1, 0)
        rig.until("SPIN on axis 1", lambda: rig.states()[0] == "SPIN")
        rig.set("cmd.enable", 0)
        rig.until("STOP", lambda: rig.states()[0] == "STOP")


def extremes(rig: Rig) -> None:
    """Top speed in both directions, set-points and limits at the ends of their ranges, limits changed in motion."""
    spin(rig)
    speed, current, current_limit = raw_range("cmd.speed"), raw_range("cmd.i_q"), raw_range("param.i_q_limit")
    rig.set("param.acceleration_limit", 50_000.0)
    rig.set("param.speed_limit", 419.0)
    rig.set("cmd.mode", SPEED)
    rig.set_raw("cmd.speed", *reversed(speed))
    rig.run(0.05)
    rig.set_raw("cmd.speed", *speed)
    rig.run(0.06)
    rig.set_raw("cmd.mode", TORQUE, POSITION)
    rig.set_raw("cmd.i_q", *current)
    rig.set_raw("cmd.position", FAR, -FAR)
    rig.run(0.02)
    rig.set_raw("param.i_q_limit", *current_limit)
    rig.set("param.speed_limit", 50.0)
    rig.run(0.02)
    rig.set_raw("cmd.position", 0, 2**31 - 1)  # refused: beyond the permitted distance
    rig.set_raw("cmd.position", 0, FAR)
    rig.set_raw("param.i_q_limit", current_limit[1], 1000)
    rig.run(0.02)


def forward(rig: Rig) -> None:
    """Feed-forward of friction, speed and acceleration, combined and alone; following error and over-speed."""
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
    rig.lock_shaft(0)
    rig.set("cmd.position", 10.0)
    rig.set("cmd.speed", 0.0, 200.0)
    rig.until("following error", lambda: "FOLLOWING_ERROR" in rig.faults(0))
    rig.until("over-speed", lambda: "OVER_SPEED" in rig.faults(1))
    rig.set_raw("param.following_error", *raw_range("param.following_error"))
    rig.set_raw("param.over_speed", *raw_range("param.over_speed"))
    rig.run(0.001)


def expired(rig: Rig) -> None:
    """Expired set-points with and without an encoder; a limit that is raised without a new set-point."""
    ready(rig)
    rig.set_raw("param.feedback", 0, 1)
    rig.set("cmd.enable", 1)
    rig.until("SPIN on axis 1", lambda: rig.states()[0] == "SPIN")
    rig.set("param.command_timeout", 0.01)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 50.0, 5.0)  # below the minimum speed of the observer: the axis waits
    rig.run(0.005)
    rig.set("param.speed_limit", 10.0)
    rig.run(0.002)
    rig.set("param.speed_limit", 100.0)
    rig.run(0.03)
    rig.set("cmd.mode", TORQUE)
    rig.set("cmd.i_q", 0.3, 0.0)
    rig.run(0.03)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 50.0, 0.0)
    rig.run(0.008)
    rig.set("cmd.mode", POSITION)
    rig.set("cmd.position", 50.0)  # far enough to remain in motion
    rig.run(0.002)


def soft_limits(rig: Rig) -> None:
    """Both soft limits in each mode, and limits at the ends of their ranges."""
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
    rig.set("param.position_min", 0.3)  # one shaft is beyond it, the other one inside
    rig.set("cmd.mode", POSITION)
    rig.set("cmd.position", -1.0, 1.0)
    rig.run(0.03)
    rig.set_raw("param.position_min", *raw_range("param.position_min"))
    rig.set_raw("param.position_max", *reversed(raw_range("param.position_max")))
    rig.set("cmd.position", 0.2)
    rig.run(0.02)
    rig.set("cmd.mode", SPEED)
    for limit in (30.0, 5.0, -5.0):  # far ahead, ahead, behind
        rig.set("param.position_min", -10.0)
        rig.set("param.position_max", limit)
        rig.set("cmd.speed", 20.0)
        rig.run(0.002)
    rig.set("param.features", features())
    rig.run(0.002)


def trajectory(rig: Rig) -> None:
    """Timed points: followed, replaced, refused for each reason, reached at rest, and missing in motion."""
    spin(rig)
    rig.points(TimedPoint(0, 8, 0.0, 0.0))  # refused: wrong mode
    rig.set("cmd.mode", TRAJECTORY)
    rig.set("param.features", features("POSITION_LIMITS"), features("STARVED", "FRICTION", "FOLLOWING_ERROR"))
    rig.set("param.position_min", -2.0)
    rig.set("param.position_max", 2.0)
    rig.run(0.01)
    here = [rig.get(f"axis{k}.position_ref") for k in (1, 2)]

    def point(
        axis: int, later: int, distance: float, speed: float = 0.0, current: float = 0.0, replaces: bool = False
    ) -> TimedPoint:
        return TimedPoint(axis, round(rig.get("tick")) + later, here[axis] + distance, speed, current, replaces)

    def refused(*points: TimedPoint) -> None:
        before = rig.get("points_refused")
        rig.points(*points)
        rig.run(0.001)  # until the next snapshot
        if rig.get("points_refused") == before:
            raise RigError(f"{points} were not refused")

    rig.points(point(0, 320, 0.1, 10.0, 0.1), point(1, 320, -0.1, -10.0), point(0, 487, 0.2, 8.0))
    rig.run(0.01)
    refused(point(1, 8, 0.0))  # in the past
    refused(point(0, 600, 0.2), point(0, 600, 0.2))  # not later
    refused(point(0, 800, 0.2), point(0, 808, 0.2))  # too close to the previous point
    refused(point(0, 2_000_000, 0.2))  # too long after the previous point
    refused(point(0, 800, 500_000.0))  # too far
    refused(point(0, 800, 30.0))  # too fast between the points
    refused(point(0, 800, 0.2, 400.0))  # too fast
    refused(point(0, 1600, 0.2, 100.0), point(0, 1632, 0.2))  # too much acceleration
    refused(point(0, 3200, 3.0))  # beyond the soft limits
    refused(point(0, 600, 0.2), point(0, 700, 0.2, replaces=True))  # replaces, but is not the first point
    rig.points(point(0, 640, 0.1, replaces=True), point(0, 800, 0.1))
    rig.points(*(point(0, 900 + 100 * k, 0.1) for k in range(8)))
    refused(*(point(0, 2000 + 100 * k, 0.1) for k in range(8)))  # queue full
    rig.words(0, 0)
    rig.words(0, 0, 0, -(2**31))
    one = point(0, 2000, 0.1, replaces=True)
    for _ in range(4):  # some are received before the slow tick of the previous one
        rig.together(*[("cmd.points", encode_points(rig.catalogue, [one]))] * 2)
    rig.until("HOST_SILENT by an underrun of points", lambda: rig.faults(1) == ["HOST_SILENT"])
    rig.run(0.002)  # until these are taken: a refusal as BUSY would depend on the instants of the bytes
    rig.points(point(0, 640, 0.1, replaces=True))
    rig.run(0.05)
    rig.points(point(0, 480, 0.3, 10.0))
    rig.run(0.05)  # axis 1 without the feature stops and holds
    rig.set("cmd.mode", POSITION, TRAJECTORY)
    rig.set("cmd.clear_faults", 1)
    stop(rig)


def field_weakening(rig: Rig) -> None:
    """Field weakening above the base speed: load, a sag of the bus to the limit, and switching it off."""
    spin(rig)
    rig.set("param.features", features("FIELD_WEAKENING"))
    rig.set("param.acceleration_limit", 30_000.0)
    rig.set("param.speed_limit", 400.0)
    rig.set_supply(17.0)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 300.0, -380.0)
    rig.run(0.03)
    rig.set_load(0, 0.05)
    rig.set_supply(16.3)
    rig.set("cmd.mode", TORQUE, SPEED)
    rig.set("cmd.i_q", 3.0, 0.0)
    rig.run(0.02)
    rig.set("param.features", features(), features("FIELD_WEAKENING"))
    rig.set("cmd.speed", 0.0, 100.0)
    rig.run(0.02)
