"""Faults of motors, sensors, power stage and core, and failures of host and supply."""

from __future__ import annotations

import math

from servo_msgs_py.axis_config_transfer import read_block, send_configuration
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

from targets.rig import Rig, RigError
from targets.scenarios.parts import ALL_FAULTS, FAULTS_WITHOUT_MONITORS, POSITION, SPEED, TORQUE, features, ready, spin


def random_inputs(rig: Rig) -> None:
    """Random analogue inputs and edges, a load that drives the shaft (RUNAWAY), then a silent host."""
    spin(rig)
    rig.set_raw("param.host_timeout", 0)  # refused
    rig.set("param.faults_enabled", FAULTS_WITHOUT_MONITORS)
    rig.set("cmd.mode", POSITION)
    rig.set("cmd.position", -50.0)
    rig.disturb(0, 1, one_in=4)
    rig.run(0.03)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", -100.0)
    rig.set("cmd.i_q", 2.0)
    rig.run(0.02)
    rig.end_disturbance()
    rig.set("cmd.i_q", 0.0)
    rig.set_load(1, -0.2)
    rig.until("the load runs away", lambda: "RUNAWAY" in rig.faults(1))
    rig.set_load(1, 0.0)
    rig.set("param.host_timeout", 0.05)
    rig.until("host time-out", lambda: "HOST_SILENT" in rig.faults(0), silent=True)
    rig.until("outputs off at the ramp's end", lambda: rig.states()[0] == "FAULT", silent=True)


def bus_faults(rig: Rig) -> None:
    """Under-voltage in operation, recovery, and over-voltage at rest."""
    spin(rig)
    rig.set_load(0, 0.08)  # the holding current discharges the capacitor
    rig.set_supply(12.0)
    rig.until("under-voltage", lambda: "UNDER_VOLTAGE" in rig.faults(0))
    rig.set_load(0, 0.0)
    rig.set_supply(24.0)
    rig.run(0.01)
    rig.command("CLEAR_FAULTS")
    rig.until("both axes cleared", lambda: rig.states() == ["STOP", "STOP"])
    rig.set_supply(36.0)
    rig.until("over-voltage in STOP", lambda: "OVER_VOLTAGE" in rig.faults(1))
    rig.run(0.002)


def bad_supply(rig: Rig) -> None:
    """Over-voltage at power-on."""
    rig.set_supply(36.0)
    rig.until("over-voltage in INIT", lambda: rig.states() == ["FAULT", "FAULT"])
    rig.set("cmd.clear_faults", 1)  # too early
    rig.set("cmd.enable", 1)
    rig.run(0.002)


def searches(rig: Rig) -> None:
    """Rotor search with an open motor cable, with a blocked shaft and with a dead encoder: different faults."""
    ready(rig)
    rig.connect_motor(0, False)
    rig.connect_encoder(1, False)
    rig.set("cmd.enable", 1)
    rig.until("no current", lambda: rig.faults(0) == ["PHASE_LOST"])
    rig.connect_motor(0, True)
    rig.lock_shaft(0)
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("axis 1 cleared", lambda: rig.states()[0] == "STOP")
    rig.set("cmd.enable", 1)
    rig.until("search failed", lambda: rig.faults(0) == ["ROTOR_SEARCH"])
    rig.until("encoder lost", lambda: rig.faults(1) == ["ENCODER_LOST"])
    rig.lock_shaft(0, locked=False)
    rig.connect_encoder(1, True)
    rig.set("cmd.clear_faults", 1)
    rig.until("both axes cleared", lambda: rig.states() == ["STOP", "STOP"])


def reversed_lines(rig: Rig) -> None:
    """A reversed encoder, found after the time of the search; a short circuit during a stall of the core."""
    ready(rig)
    send_configuration(rig, {0: {**read_block(rig, 0), "search_ticks_max": 900}})
    rig.run(0.005)
    rig.reverse_encoder(0)
    rig.set("cmd.enable", 1)
    rig.until("encoder reversed", lambda: rig.faults(0) == ["ENCODER_REVERSED"])
    rig.until("SPIN on axis 2", lambda: rig.states()[1] == "SPIN")
    rig.inject(ShortedPhase(1, "a"))
    rig.run(0.0002)  # the over-current is first; its cause is evaluated in the next slow tick
    rig.inject(StalledCore(0.001))
    rig.until("both faults", lambda: rig.faults(1) == ["OVER_CURRENT", "LATE_LOOP"])


def caught(rig: Rig) -> None:
    """A shaft that is blocked while it must follow the vector of the rotor search."""
    ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.run(0.27)
    rig.lock_shaft(0)
    for _ in range(6):
        rig.run(0.15)
        rig.set("cmd.mode", POSITION)  # keeps the host time-out of 0.5 s from expiring


def stalled(rig: Rig) -> None:
    """Blocked shafts with a speed set-point; one is released at the start of the stall test."""
    spin(rig)
    rig.lock_shaft(0)
    rig.lock_shaft(1)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("stall test", lambda: rig.states()[1] == "ALIGN")
    rig.lock_shaft(1, locked=False)
    rig.until("stalled", lambda: all("STALLED" in rig.faults(k) for k in (0, 1)))
    rig.set("cmd.enable", 1)
    rig.run(0.001)


def shaken(rig: Rig) -> None:
    """A load that alternates: smaller gains do not help, full gains are restored; the axis stops when it is large."""
    spin(rig)
    rig.set("cmd.mode", POSITION)
    for k in range(7200):
        rig.set_load(0, (0.05 if k < 4800 else 0.18) * math.sin(2.0 * math.pi * 60.0 * k * 0.00025))
        rig.wait(0.00025)
        if "OSCILLATION" in rig.faults(0):
            return
    raise RigError("an oscillation is not found")


def backlash(rig: Rig) -> None:
    """Shafts at end stops with backlash: the rotating vector of the stall test moves them only a little."""
    spin(rig)
    rig.obstruct_shaft(0, 0.005, 0.005)
    rig.obstruct_shaft(1, math.inf, 0.005)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("stalled", lambda: all("STALLED" in rig.faults(k) for k in (0, 1)))


def slipped_discs(rig: Rig) -> None:
    """Encoders slipped by 60 degrees under a load that becomes too large, and by 90 degrees; then by 180 degrees
    (electrical)."""
    spin(rig)
    rig.set_load(0, 0.06)
    rig.run(0.02)
    rig.inject(SlippedEncoder(0, -333))
    rig.inject(SlippedEncoder(1, -500))
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("fault", lambda: all("ANGLE_MISMATCH" in rig.faults(k) for k in (0, 1)))
    rig.set_load(0, 0.0)
    rig.run(0.05)
    rig.set("cmd.clear_faults", 1)
    rig.run(0.01)
    rig.set("cmd.enable", 1)
    rig.until("SPIN on both axes", lambda: rig.states() == ["SPIN", "SPIN"])
    rig.inject(SlippedEncoder(0, 1000))
    rig.set("cmd.speed", 60.0)
    rig.until("fault", lambda: "ANGLE_MISMATCH" in rig.faults(0))


def silent_encoder(rig: Rig) -> None:
    """Coasting shafts without current: one loses its encoder, the other one is stopped abruptly. It then
    stalls without an encoder and is released at the start of the stall test."""
    spin(rig)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 50.0)
    rig.run(0.06)
    rig.set("cmd.mode", TORQUE)
    rig.set("cmd.i_q", 0.0)
    rig.run(0.002)
    rig.connect_encoder(0, False)
    rig.lock_shaft(1)
    rig.until("encoder lost", lambda: "ENCODER_LOST" in rig.faults(0))
    rig.run(0.05)
    rig.connect_encoder(1, False)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("stall test", lambda: rig.states()[1] == "ALIGN")
    rig.lock_shaft(1, locked=False)
    rig.until("fault", lambda: "ENCODER_LOST" in rig.faults(1))


def quiet_losses(rig: Rig) -> None:
    """An encoder with one stuck line at low speed; an open motor cable at a small current, at rest and in motion."""
    spin(rig)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 20.0, 0.0)
    rig.run(0.03)
    rig.lock_shaft(1)
    rig.connect_motor(1, False)
    rig.set("cmd.mode", TORQUE)
    rig.set("cmd.i_q", 0.0, 0.1)
    rig.inject(StuckLine(0, "A"))
    rig.until("single-channel count", lambda: rig.faults(0) == ["ENCODER_LOST"])
    rig.until("phase lost at a small current", lambda: rig.faults(1) == ["PHASE_LOST"])
    rig.clear_fault(StuckLine(0, "A"))
    rig.lock_shaft(1, locked=False)
    rig.connect_motor(1, True)
    rig.set("cmd.clear_faults", 1)
    rig.until("axis 2 cleared", lambda: rig.states()[1] == "STOP")
    rig.set("cmd.enable", 0, 1)
    rig.until("SPIN on axis 2", lambda: rig.states()[1] == "SPIN")
    rig.set("cmd.i_q", 0.0, 1.0)
    rig.run(0.03)
    rig.connect_motor(1, False)
    rig.until("phase lost in motion", lambda: rig.faults(1) == ["PHASE_LOST"])


def lost_index(rig: Rig) -> None:
    """Quick stop and restart, with and without the features of the reference design; then loss of the index."""
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
    rig.until("index lost", lambda: all("ENCODER" in rig.faults(k) for k in (0, 1)))
    rig.lose_index(False)
    rig.lock_shaft(0)  # shortens coasting
    rig.lock_shaft(1)
    rig.set("cmd.clear_faults", 1)
    rig.until("both axes cleared", lambda: rig.states() == ["STOP", "STOP"])


def over_current(rig: Rig) -> None:
    """Over-current trips of the hardware, by wrong current feedback and by a cut cable."""
    spin(rig)
    rig.set("cmd.mode", TORQUE)
    rig.set("cmd.quick_stop", 1)
    rig.run(0.002)
    rig.set("cmd.enable", 1)
    rig.lock_shaft(0)
    rig.set("cmd.i_q", 3.9, -3.9)
    rig.run(0.004)
    rig.inject(OpenPhase(0, "b"))
    rig.run(0.0015)
    rig.inject(ShortedPhase(0, "c"))
    rig.until("over-current and its cause", lambda: rig.faults(0) == ["OVER_CURRENT", "PHASE_LOST"])
    rig.set("param.faults_enabled", FAULTS_WITHOUT_MONITORS)
    rig.disturb(1, one_in=2)
    rig.until("over-current", lambda: "OVER_CURRENT" in rig.faults(1))
    rig.end_disturbance()
    rig.clear_fault(OpenPhase(0, "b"))
    rig.clear_fault(ShortedPhase(0, "c"))
    rig.run(0.002)
    rig.set("cmd.clear_faults", 1)
    rig.run(0.01)


def wrong_offset(rig: Rig) -> None:
    """An amplifier with a large offset prevents the start."""
    ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("offset refused", lambda: rig.faults(1) == ["CURRENT_OFFSET"])
    rig.set("cmd.clear_faults", 1)
    rig.run(0.002)


def broken_phases(rig: Rig) -> None:
    """A phase lost in motion; converters with a constant code, alone and after the lost phase."""
    spin(rig)
    rig.set("param.monitor", 8.0, 13.0)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 80.0, -80.0)
    rig.run(0.06)
    rig.inject(OpenPhase(0, "a"))
    rig.until("phase lost", lambda: rig.faults(0) == ["PHASE_LOST"])
    rig.set("param.monitor", 1.0, 0.0)
    rig.inject(CurrentNoise(0, 0.02))  # without noise every code is constant
    rig.inject(StuckConverter(0, "c", 2100))
    rig.inject(StuckConverter(1, "b", 2150))
    rig.until("converter", lambda: "CURRENT_SENSE" in rig.faults(1))
    rig.until("root cause revised", lambda: rig.faults(0) == ["CURRENT_SENSE"])
    rig.clear_fault(OpenPhase(0, "a"))
    rig.clear_fault(StuckConverter(0, "c", 2100))
    rig.clear_fault(StuckConverter(1, "b", 2150))
    rig.run(0.01)
    rig.clear_fault(CurrentNoise(0, 0.02))
    rig.lock_shaft(0)
    rig.lock_shaft(1)
    rig.set("cmd.clear_faults", 1)
    rig.until("both axes cleared", lambda: rig.states() == ["STOP", "STOP"])


def broken_encoders(rig: Rig) -> None:
    """One and two dead encoder lines, over-temperature, and a stalled core: briefly, then until the watchdog reset."""
    spin(rig)
    rig.set("param.faults_enabled", ALL_FAULTS)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 100.0, -100.0)
    rig.run(0.06)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.i_q", 0.0)  # without current the monitor has to apply a test current
    rig.run(0.01)
    rig.inject(StuckLine(0, "A"))
    rig.connect_encoder(1, False)
    rig.until("encoders lost", lambda: all("ENCODER_LOST" in rig.faults(k) for k in (0, 1)))
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
