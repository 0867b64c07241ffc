"""Angle and speed from currents and voltages: without encoders, and beside them."""

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
    rig.until("READY on both axes", lambda: rig.places() == ["READY", "READY"])
    rig.set("cmd.speed", *speeds)


def sensorless(rig: Rig) -> None:
    """Without encoders: start both ways, caught on the fly, every mode, below the minimum, off."""
    _sensorless(rig, 80.0, -60.0)
    rig.until("both spin", lambda: rig.places() == ["SPIN", "SPIN"])
    rig.run(0.03)
    rig.set("param.features", features("OVER_SPEED"), features())
    rig.set("param.over_speed", 5.0)
    rig.until("too fast", lambda: "OVER_SPEED" in rig.faults(0))
    rig.set("param.features", features())
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("axis 1 cleared", lambda: rig.places()[0] == "STOP")
    rig.set("cmd.enable", 1)
    rig.set("cmd.speed", 80.0, 5.0)
    rig.until("caught", lambda: rig.places()[0] == "SPIN")
    rig.set("cmd.mode", TORQUE, POSITION)
    rig.set("cmd.i_q", 0.2, 0.0)
    rig.run(0.02)
    rig.set("cmd.quick_stop", 1, 0)
    rig.until("both wait", lambda: rig.places() == ["READY", "READY"])
    rig.run(0.005)
    rig.set("cmd.enable", 1)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 419.0, -419.0)
    rig.until("both start", lambda: rig.places() == ["STARTUP", "STARTUP"])
    rig.run(0.03)
    rig.set("cmd.speed", 0.0, -60.0)
    rig.run(0.005)
    rig.until("axis 2 spins", lambda: rig.places()[1] == "SPIN")
    rig.set("cmd.mode", SPEED, POSITION)  # which it cannot
    rig.run(0.001)
    rig.set("param.features", features(), features("OVER_SPEED"))
    rig.until("too fast", lambda: "OVER_SPEED" in rig.faults(1))
    rig.set("param.features", features())
    rig.set("cmd.clear_faults", 0, 1)
    rig.until("axis 2 cleared", lambda: rig.places()[1] == "STOP")
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.enable", 0, 1)
    rig.set("cmd.speed", 0.0, -60.0)
    rig.until("caught", lambda: rig.places()[1] == "STARTUP")
    rig.run(0.006)
    rig.lock(1)
    rig.run(0.1)
    rig.lock(1, locked=False)
    stop(rig)


def sensorless_lost(rig: Rig) -> None:
    """A shaft that is held at speed, and from the beginning."""
    _sensorless(rig, -80.0, 0.0)
    rig.until("axis 1 spins", lambda: rig.places()[0] == "SPIN")
    rig.run(0.02)
    rig.inject(CurrentNoise(0, 0.02))  # without noise a converter of a shaft that stands repeats its code
    rig.lock(0)
    rig.until("stall seen", lambda: rig.faults(0) == ["SPEED_FEEDBACK"])
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("axis 1 cleared", lambda: rig.places()[0] == "STOP")
    rig.clear_fault(CurrentNoise(0, 0.02))
    rig.set("cmd.enable", 1, 0)
    rig.until("axis 1 waits", lambda: rig.places()[0] == "READY")
    rig.motor(0, False)  # what does not change makes a short recording
    rig.set("cmd.speed", 100.0, 0.0)
    for _ in range(10):
        rig.run(0.15)
        rig.set("cmd.mode", SPEED)
    rig.motor(0, True)
    rig.until("no start-up", lambda: rig.faults(0) == ["START_UP"])


def slipped(rig: Rig) -> None:
    """The observer beside the encoders: one fails while its shaft turns. The other axis has no current."""
    spin(rig)
    rig.set("param.features", features("ANGLE_CHECK"))
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 80.0)
    rig.set("param.features", features("ANGLE_CHECK"), features())
    rig.motor(1, False)
    rig.set("cmd.i_q", 0.5)
    rig.run(0.01)
    rig.set("cmd.i_q", -0.5)  # what the controllers have added up turns round like a back-EMF
    rig.run(0.05)
    rig.plug(0, False)
    rig.run(0.0015)
    rig.plug(0, True)
    rig.run(0.01)
    rig.plug(0, False)
    rig.until("encoder caught out", lambda: "ANGLE_MISMATCH" in rig.faults(0))
    rig.until("cable missed", lambda: rig.faults(1) == ["PHASE_LOST"])
    rig.run(0.005)
