"""Observer of angle and speed: without encoders, and as a check of the encoders."""

from __future__ import annotations

from typing import Final

from servo_twin.fault_injection import CurrentNoise

from targets.rig import Rig
from targets.scenarios.parts import POSITION, SPEED, TORQUE, features, ready, spin, stop

_OBSERVER: Final = 1


def _sensorless(rig: Rig, *speeds: float) -> None:
    """Both axes without their encoders, enabled with speed set-points."""
    rig.set_raw("param.feedback", _OBSERVER, _OBSERVER)
    ready(rig)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.enable", 1)
    rig.until("READY on both axes", lambda: rig.states() == ["READY", "READY"])
    rig.set("cmd.speed", *speeds)


def sensorless(rig: Rig) -> None:
    """Without encoders: start in both directions, flying start, every mode, below the minimum speed, off."""
    _sensorless(rig, 80.0, -60.0)
    rig.until("both spin", lambda: rig.states() == ["SPIN", "SPIN"])
    rig.run(0.03)
    rig.set("param.features", features("OVER_SPEED"), features())
    rig.set("param.over_speed", 5.0)
    rig.until("over-speed", lambda: "OVER_SPEED" in rig.faults(0))
    rig.set("param.features", features())
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("axis 1 cleared", lambda: rig.states()[0] == "STOP")
    rig.set("cmd.enable", 1)
    rig.set("cmd.speed", 80.0, 5.0)
    rig.until("flying start", lambda: rig.states()[0] == "SPIN")
    rig.set("cmd.mode", TORQUE, POSITION)
    rig.set("cmd.i_q", 0.2, 0.0)
    rig.run(0.02)
    rig.set("cmd.quick_stop", 1, 0)
    rig.until("both wait", lambda: rig.states() == ["READY", "READY"])
    rig.run(0.005)
    rig.set("cmd.enable", 1)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 419.0, -419.0)
    rig.until("both start", lambda: rig.states() == ["STARTUP", "STARTUP"])
    rig.run(0.03)
    rig.set("cmd.speed", 0.0, -60.0)
    rig.run(0.005)
    rig.until("axis 2 spins", lambda: rig.states()[1] == "SPIN")
    rig.set("cmd.mode", SPEED, POSITION)  # refused without an encoder
    rig.run(0.001)
    rig.set("param.features", features(), features("OVER_SPEED"))
    rig.until("over-speed", lambda: "OVER_SPEED" in rig.faults(1))
    rig.set("param.features", features())
    rig.set("cmd.clear_faults", 0, 1)
    rig.until("axis 2 cleared", lambda: rig.states()[1] == "STOP")
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.enable", 0, 1)
    rig.set("cmd.speed", 0.0, -60.0)
    rig.until("flying start", lambda: rig.states()[1] == "STARTUP")
    rig.run(0.006)
    rig.lock_shaft(1)
    rig.run(0.1)
    rig.lock_shaft(1, locked=False)
    stop(rig)


def sensorless_lost(rig: Rig) -> None:
    """A shaft that is blocked at speed, and one without current at the start."""
    _sensorless(rig, -80.0, 0.0)
    rig.until("axis 1 spins", lambda: rig.states()[0] == "SPIN")
    rig.run(0.02)
    rig.inject(CurrentNoise(0, 0.02))  # without noise the codes of a shaft at standstill are constant
    rig.lock_shaft(0)
    rig.until("stall", lambda: rig.faults(0) == ["SPEED_FEEDBACK"])
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("axis 1 cleared", lambda: rig.states()[0] == "STOP")
    rig.clear_fault(CurrentNoise(0, 0.02))
    rig.set("cmd.enable", 1, 0)
    rig.until("axis 1 waits", lambda: rig.states()[0] == "READY")
    rig.connect_motor(0, False)  # constant signals make a short recording
    rig.set("cmd.speed", 100.0, 0.0)
    for _ in range(10):
        rig.run(0.15)
        rig.set("cmd.mode", SPEED)
    rig.connect_motor(0, True)
    rig.until("no start-up", lambda: rig.faults(0) == ["START_UP"])


def slipped(rig: Rig) -> None:
    """Encoder check by the observer: one encoder fails in motion; the other axis has no current."""
    spin(rig)
    rig.set("param.features", features("ANGLE_CHECK"))
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 80.0)
    rig.set("param.features", features("ANGLE_CHECK"), features())
    rig.connect_motor(1, False)
    rig.set("cmd.i_q", 0.5)
    rig.run(0.01)
    rig.set("cmd.i_q", -0.5)  # the integrators of the controllers rotate like a back-EMF
    rig.run(0.05)
    rig.connect_encoder(0, False)
    rig.run(0.0015)
    rig.connect_encoder(0, True)
    rig.run(0.01)
    rig.connect_encoder(0, False)
    rig.until("angle mismatch", lambda: "ANGLE_MISMATCH" in rig.faults(0))
    rig.until("phase lost", lambda: rig.faults(1) == ["PHASE_LOST"])
    rig.run(0.005)
