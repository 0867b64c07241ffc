"""What breaks, and what a host or a bus does to a board."""

from __future__ import annotations

import math

from servo_twin.fault_injection import (
    CurrentNoise,
    HotPowerStage,
    OpenPhase,
    ShortedPhase,
    SlippedEncoder,
    StalledCore,
    StuckConverter,
    StuckLine,
)

from targets.rig import Rig
from targets.scenarios.parts import ALL_FAULTS, BLIND, POSITION, SPEED, TORQUE, features, ready, spin


def random_inputs(rig: Rig) -> None:
    """Analogue inputs and edges that make no sense, a load that runs away, and in the end a host that falls silent."""
    spin(rig)
    rig.set_raw("param.host_timeout", 0)  # refused
    rig.set("param.faults_enabled", BLIND)
    rig.set("cmd.mode", POSITION)
    rig.set("cmd.position", -50.0)
    rig.disturb(0, 1, one_in=4)
    rig.run(0.03)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", -100.0)
    rig.set("cmd.i_q", 2.0)
    rig.run(0.02)
    rig.calm()
    rig.set("cmd.i_q", 0.0)
    rig.load(1, -0.2)
    rig.until("the load runs away", lambda: "RUNAWAY" in rig.faults(1))
    rig.load(1, 0.0)
    rig.set("param.host_timeout", 0.05)
    rig.until("the host is missed", lambda: "HOST_SILENT" in rig.faults(0), silent=True)
    rig.until("outputs off at the ramp's end", lambda: rig.places()[0] == "FAULT", silent=True)


def bus_faults(rig: Rig) -> None:
    """Under-voltage on the way, the way back, and over-voltage at rest."""
    spin(rig)
    rig.load(0, 0.08)  # holding against it empties the capacitor
    rig.supply(12.0)
    rig.until("under-voltage", lambda: "UNDER_VOLTAGE" in rig.faults(0))
    rig.load(0, 0.0)
    rig.supply(24.0)
    rig.run(0.01)
    rig.command("CLEAR_FAULTS")
    rig.until("both axes cleared", lambda: rig.places() == ["STOP", "STOP"])
    rig.supply(36.0)
    rig.until("over-voltage in STOP", lambda: "OVER_VOLTAGE" in rig.faults(1))
    rig.run(0.002)


def bad_supply(rig: Rig) -> None:
    """Too much from the beginning."""
    rig.supply(36.0)
    rig.until("over-voltage in INIT", lambda: rig.places() == ["FAULT", "FAULT"])
    rig.set("cmd.clear_faults", 1)  # too early
    rig.set("cmd.enable", 1)
    rig.run(0.002)


def searches(rig: Rig) -> None:
    """A motor cable that is off, a shaft held fast and an encoder that says nothing are told apart."""
    ready(rig)
    rig.motor(0, False)
    rig.plug(1, False)
    rig.set("cmd.enable", 1)
    rig.until("no current", lambda: rig.faults(0) == ["PHASE_LOST"])
    rig.motor(0, True)
    rig.lock(0)
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("axis 1 cleared", lambda: rig.places()[0] == "STOP")
    rig.set("cmd.enable", 1)
    rig.until("search given up", lambda: rig.faults(0) == ["ROTOR_SEARCH"])
    rig.until("encoder missed", lambda: rig.faults(1) == ["ENCODER_LOST"])
    rig.lock(0, locked=False)
    rig.plug(1, True)
    rig.set("cmd.clear_faults", 1)
    rig.until("both axes cleared", lambda: rig.places() == ["STOP", "STOP"])


def reversed_lines(rig: Rig) -> None:
    """An encoder that counts backwards; a short while the software stands still."""
    ready(rig)
    rig.reverse(0)
    rig.set("cmd.enable", 1)
    rig.until("encoder reversed", lambda: rig.faults(0) == ["ENCODER_REVERSED"])
    rig.until("SPIN on axis 2", lambda: rig.places()[1] == "SPIN")
    rig.inject(ShortedPhase(1, "a"))
    rig.run(0.0002)  # the over-current comes first, its cause is counted in the next slow tick
    rig.inject(StalledCore(0.001))
    rig.until("both noticed", lambda: rig.faults(1) == ["OVER_CURRENT", "LATE_LOOP"])


def caught(rig: Rig) -> None:
    """A shaft that is held when it has to follow the vector."""
    ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.run(0.27)
    rig.lock(0)
    for _ in range(6):
        rig.run(0.15)
        rig.set("cmd.mode", POSITION)  # a host that says nothing for half a second is a fault


def stalled(rig: Rig) -> None:
    """Shafts held fast while they shall turn; one is let go when the vector begins to ask whether it is."""
    spin(rig)
    rig.lock(0)
    rig.lock(1)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("asked", lambda: rig.places()[1] == "ALIGN")
    rig.lock(1, locked=False)
    rig.until("stalled", lambda: all("STALLED" in rig.faults(k) for k in (0, 1)))
    rig.set("cmd.enable", 1)
    rig.run(0.001)


def backlash(rig: Rig) -> None:
    """Against an end stop with little room behind: the vector that turns moves the shaft, but not for long."""
    spin(rig)
    rig.obstruct(0, 0.005, 0.005)
    rig.obstruct(1, math.inf, 0.005)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("stalled", lambda: all("STALLED" in rig.faults(k) for k in (0, 1)))


def slipped_discs(rig: Rig) -> None:
    """Encoders that are off by 60 degrees under a load that is too much then, and by a quarter turn; then by half a
    turn."""
    spin(rig)
    rig.load(0, 0.06)
    rig.run(0.02)
    rig.inject(SlippedEncoder(0, -333))
    rig.inject(SlippedEncoder(1, -500))
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("told", lambda: all("ANGLE_MISMATCH" in rig.faults(k) for k in (0, 1)))
    rig.load(0, 0.0)
    rig.run(0.05)
    rig.set("cmd.clear_faults", 1)
    rig.run(0.01)
    rig.set("cmd.enable", 1)
    rig.until("SPIN on both axes", lambda: rig.places() == ["SPIN", "SPIN"])
    rig.inject(SlippedEncoder(0, 1000))
    rig.set("cmd.speed", 60.0)
    rig.until("seen", lambda: "ANGLE_MISMATCH" in rig.faults(0))


def silent_encoder(rig: Rig) -> None:
    """Shafts that coast without current: one loses its encoder, the other one is stopped at once. It stalls without an
    encoder, and is let go when the vector begins to turn."""
    spin(rig)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 50.0)
    rig.run(0.06)
    rig.set("cmd.mode", TORQUE)
    rig.set("cmd.i_q", 0.0)
    rig.run(0.002)
    rig.plug(0, False)
    rig.lock(1)
    rig.until("missed", lambda: "ENCODER_LOST" in rig.faults(0))
    rig.run(0.05)
    rig.plug(1, False)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("asked", lambda: rig.places()[1] == "ALIGN")
    rig.lock(1, locked=False)
    rig.until("told", lambda: "ENCODER_LOST" in rig.faults(1))


def quiet_losses(rig: Rig) -> None:
    """A slow shaft whose encoder has one line left; a motor cable off at a small current at rest, and in motion."""
    spin(rig)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 20.0, 0.0)
    rig.run(0.03)
    rig.lock(1)
    rig.motor(1, False)
    rig.set("cmd.mode", TORQUE)
    rig.set("cmd.i_q", 0.0, 0.1)
    rig.inject(StuckLine(0, "A"))
    rig.until("toggles", lambda: rig.faults(0) == ["ENCODER_LOST"])
    rig.until("small current missed", lambda: rig.faults(1) == ["PHASE_LOST"])
    rig.clear_fault(StuckLine(0, "A"))
    rig.lock(1, locked=False)
    rig.motor(1, True)
    rig.set("cmd.clear_faults", 1)
    rig.until("axis 2 cleared", lambda: rig.places()[1] == "STOP")
    rig.set("cmd.enable", 0, 1)
    rig.until("SPIN on axis 2", lambda: rig.places()[1] == "SPIN")
    rig.set("cmd.i_q", 0.0, 1.0)
    rig.run(0.03)
    rig.motor(1, False)
    rig.until("current missed in motion", lambda: rig.faults(1) == ["PHASE_LOST"])


def lost_index(rig: Rig) -> None:
    """Quick stop and again, with and without the features of the reference design; then the index is gone."""
    spin(rig)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0, -60.0)
    rig.run(0.02)
    rig.set("param.features", features(), 0)
    rig.run(0.02)
    rig.set("cmd.quick_stop", 0, 1)
    rig.run(0.02)
    rig.set("cmd.enable", 1)
    rig.set("cmd.speed", 150.0, -150.0)
    rig.run(0.04)
    rig.lose_index(True)
    rig.until("index missed", lambda: all("ENCODER" in rig.faults(k) for k in (0, 1)))
    rig.lose_index(False)
    rig.lock(0)  # they would coast for long
    rig.lock(1)
    rig.set("cmd.clear_faults", 1)
    rig.until("both axes cleared", lambda: rig.places() == ["STOP", "STOP"])


def over_current(rig: Rig) -> None:
    """With wrong current feedback the current overshoots and the hardware opens the switches; as with a cut cable."""
    spin(rig)
    rig.set("cmd.mode", TORQUE)
    rig.set("cmd.quick_stop", 1)
    rig.run(0.002)
    rig.set("cmd.enable", 1)
    rig.lock(0)
    rig.set("cmd.i_q", 3.9, -3.9)
    rig.run(0.004)
    rig.inject(OpenPhase(0, "b"))
    rig.run(0.0015)
    rig.inject(ShortedPhase(0, "c"))
    rig.until("over-current and its cause", lambda: rig.faults(0) == ["OVER_CURRENT", "PHASE_LOST"])
    rig.set("param.faults_enabled", BLIND)
    rig.disturb(1, one_in=2)
    rig.until("over-current", lambda: "OVER_CURRENT" in rig.faults(1))
    rig.calm()
    rig.clear_fault(OpenPhase(0, "b"))
    rig.clear_fault(ShortedPhase(0, "c"))
    rig.run(0.002)
    rig.set("cmd.clear_faults", 1)
    rig.run(0.01)


def wrong_offset(rig: Rig) -> None:
    """An amplifier that is far off stops the start."""
    ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("offset refused", lambda: rig.faults(1) == ["CURRENT_OFFSET"])
    rig.set("cmd.clear_faults", 1)
    rig.run(0.002)


def broken_phases(rig: Rig) -> None:
    """Phases lost while they turn and while they hold a load; a converter that repeats itself, or says too much."""
    spin(rig)
    rig.set("param.monitor", 8.0, 13.0)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 80.0, -80.0)
    rig.run(0.06)
    rig.inject(OpenPhase(0, "a"))
    rig.until("phase lost", lambda: rig.faults(0) == ["PHASE_LOST"])
    rig.set("param.monitor", 1.0, 0.0)
    rig.inject(CurrentNoise(0, 0.02))  # without noise every code repeats itself
    rig.inject(StuckConverter(0, "c", 2100))
    rig.inject(StuckConverter(1, "b", 2150))
    rig.until("converter", lambda: "CURRENT_SENSE" in rig.faults(1))
    rig.until("root cause revised", lambda: rig.faults(0) == ["CURRENT_SENSE"])
    rig.clear_fault(OpenPhase(0, "a"))
    rig.clear_fault(StuckConverter(0, "c", 2100))
    rig.clear_fault(StuckConverter(1, "b", 2150))
    rig.run(0.01)
    rig.clear_fault(CurrentNoise(0, 0.02))
    rig.lock(0)
    rig.lock(1)
    rig.set("cmd.clear_faults", 1)
    rig.until("both axes cleared", lambda: rig.places() == ["STOP", "STOP"])


def broken_encoders(rig: Rig) -> None:
    """A line dead, both lines dead, and a core that stands still: for a moment, then until the watchdog resets it."""
    spin(rig)
    rig.set("param.faults_enabled", ALL_FAULTS)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 100.0, -100.0)
    rig.run(0.06)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.i_q", 0.0)  # where no current flows, the watch has to ask for some
    rig.run(0.01)
    rig.inject(StuckLine(0, "A"))
    rig.plug(1, False)
    rig.until("lines missed", lambda: all("ENCODER_LOST" in rig.faults(k) for k in (0, 1)))
    rig.inject(HotPowerStage(0, 120.0))
    rig.until("heat", lambda: "OVER_TEMPERATURE" in rig.faults(0))
    rig.set("cmd.clear_faults", 1)
    rig.clear_fault(HotPowerStage(0, 120.0))
    rig.run(0.01)
    rig.inject(StalledCore(0.001))
    rig.until("late loops", lambda: "LATE_LOOP" in rig.faults(1))
    rig.inject(StalledCore(0.2))
    rig.run(0.06)
    rig.until("watchdog", lambda: "WATCHDOG" in rig.faults(0))
