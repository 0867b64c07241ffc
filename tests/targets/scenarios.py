"""What boards go through while they are recorded: together every state, mode, fault and limit of the firmware.

Each begins with a board that has just been switched on, and is short: a simulator of a small machine needs ten seconds
for each second of it, and has to hold the recording in its flash.
"""

from __future__ import annotations

import math
from typing import Any, Final

from servo_bridge.freemaster import commands
from servo_msgs_py.catalogue import Catalogue
from servo_twin.harm import CurrentNoise, HotPowerStage, OpenPhase, ShortedPhase, StalledCore, StuckConverter, StuckLine
from servo_twin.plant import PlantConfig

from targets import server_requests
from targets.recording import Scenario
from targets.rig import Rig

POSITION: Final = 0
SPEED: Final = 1
TORQUE: Final = 2

COAST: Final = 0
SHORT: Final = 1
RAMP: Final = 2
HOLD: Final = 3

INT16: Final = (-(2**15), 2**15 - 1)
INT32: Final = (-(2**31), 2**31 - 1)

_FEATURES: Final = {flag.name: flag.mask for flag in Catalogue.load().flags["features"]}
_REFERENCE_DESIGN: Final = sum(
    _FEATURES[name] for name in ("ANTI_WINDUP", "ENHANCED_MT", "BUS_COMPENSATION", "DEAD_TIME")
)
_ALL_FAULTS: Final = sum(flag.mask for flag in Catalogue.load().flags["faults"])
_BLIND: Final = sum(
    flag.mask
    for flag in Catalogue.load().flags["faults"]
    if flag.name not in ("CURRENT_SENSE", "PHASE_LOST", "ENCODER_LOST")
)
"""Faults of an axis that shall bear senseless inputs."""
_QUICK: Final = (0.0, math.pi / 4)
"""Rotor angles that are found soon [rad]."""


def _plant(theta: tuple[float, float] = _QUICK, capacitance: float = 4.7e-3, **axis: Any) -> PlantConfig:
    """Motors of the packaged description, with quieter sensors, which make short recordings."""
    plant = PlantConfig.load().with_bus(u_noise=0.005, capacitance=capacitance)
    for index in range(2):
        plant = plant.with_axis(index, **{"i_noise": 0.002, "theta_start": theta[index], **axis})
    return plant


def _features(*names: str) -> int:
    """Features of the reference design and those named."""
    return _REFERENCE_DESIGN + sum(_FEATURES[name] for name in names)


def _ready(rig: Rig) -> None:
    rig.until("STOP after reset", lambda: rig.places() == ["STOP", "STOP"])


def _spin(rig: Rig) -> None:
    """Switch both axes on and wait until they hold their position."""
    _ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("SPIN on both axes", lambda: rig.places() == ["SPIN", "SPIN"])


def _stop(rig: Rig) -> None:
    rig.set("cmd.enable", 0)
    rig.until("STOP", lambda: rig.places() == ["STOP", "STOP"])


def start_to_stop(rig: Rig) -> None:
    """Power-on, rotor search, a move in each mode under load, ramp down, free wheel, STOP."""
    _spin(rig)
    rig.set("cmd.position", 1.0, -3.0)
    rig.run(0.05)
    rig.load(0, 0.03)
    rig.run(0.01)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 150.0, 0.0)
    rig.set("cmd.i_q", 0.0, -0.3)
    rig.run(0.04)
    rig.load(0, 0.0)
    _stop(rig)
    rig.run(0.004)


def second_thoughts(rig: Rig) -> None:
    """Off and on again in every sub-state that has a way back."""
    _ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("CALIB on both axes", lambda: rig.places() == ["CALIB", "CALIB"])
    _stop(rig)
    rig.set("cmd.enable", 1)
    rig.until("ALIGN on both axes", lambda: rig.places() == ["ALIGN", "ALIGN"])
    _stop(rig)
    _spin(rig)
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
    _stop(rig)


def once_more(rig: Rig) -> None:
    """A second alignment, which leaves the turns as they are; the other axis is off."""
    _ready(rig)
    for _ in range(2):
        rig.set("cmd.enable", 1, 0)
        rig.until("SPIN on axis 1", lambda: rig.places()[0] == "SPIN")
        rig.set("cmd.enable", 0)
        rig.until("STOP", lambda: rig.places()[0] == "STOP")


def extremes(rig: Rig) -> None:
    """Top speed both ways, set-points and limits at the ends of their numbers, limits that change on the way."""
    _spin(rig)
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


def random_inputs(rig: Rig) -> None:
    """Analogue inputs and edges that make no sense, a load that runs away, and in the end a host that falls silent."""
    _spin(rig)
    rig.set_raw("param.host_timeout", 0)  # below its limits
    rig.set("param.faults_enabled", _BLIND)
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
    rig.until("the host is missed", lambda: "HOST_SILENT" in rig.faults(0), silent=True)
    rig.until("outputs off at the ramp's end", lambda: rig.places()[0] == "FAULT", silent=True)


def bus_faults(rig: Rig) -> None:
    """Under-voltage on the way, the way back, and over-voltage at rest."""
    _spin(rig)
    rig.load(0, 0.08)  # holding against it empties the capacitor
    rig.supply(12.0)
    rig.until("under-voltage", lambda: "UNDER_VOLTAGE" in rig.faults(0))
    rig.load(0, 0.0)
    rig.supply(24.0)
    rig.run(0.01)
    rig.request(commands.send_command(2))  # clear faults
    rig.request(commands.get_command_status())
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
    _ready(rig)
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
    """An encoder that counts backwards."""
    _ready(rig)
    rig.reverse(0)
    rig.set("cmd.enable", 1, 0)
    rig.until("encoder reversed", lambda: rig.faults(0) == ["ENCODER_REVERSED"])


def caught(rig: Rig) -> None:
    """A shaft that is held when it has to follow the vector."""
    _ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.run(0.27)
    rig.lock(0)
    for _ in range(6):
        rig.run(0.15)
        rig.set("cmd.mode", POSITION)  # a host that says nothing for half a second is a fault


def stalled(rig: Rig) -> None:
    """A shaft held fast while it shall turn; the other axis is off."""
    _ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.places()[0] == "SPIN")
    rig.lock(0)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0)
    rig.until("stalled", lambda: "STALLED" in rig.faults(0))
    rig.set("cmd.enable", 1)
    rig.run(0.001)


def lost_index(rig: Rig) -> None:
    """Quick stop and again, with and without the features of the reference design; then the index is gone."""
    _spin(rig)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 60.0, -60.0)
    rig.run(0.02)
    rig.set("param.features", _features(), 0)
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
    """A controller that is lied to overshoots, and the hardware opens the switches; so it does for a broken cable."""
    _spin(rig)
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
    rig.set("param.faults_enabled", _BLIND)
    rig.disturb(1, one_in=2)
    rig.until("over-current", lambda: "OVER_CURRENT" in rig.faults(1))
    rig.calm()
    rig.heal(OpenPhase(0, "b"))
    rig.heal(ShortedPhase(0, "c"))
    rig.run(0.002)
    rig.set("cmd.clear_faults", 1)
    rig.run(0.01)


def wrong_offset(rig: Rig) -> None:
    """An amplifier that is far off stops the start."""
    _ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("offset refused", lambda: rig.faults(1) == ["CURRENT_OFFSET"])
    rig.set("cmd.clear_faults", 1)
    rig.run(0.002)


def forward(rig: Rig) -> None:
    """Friction, speed and acceleration fed forward, together and alone; a shaft left behind, and a shaft too fast."""
    _spin(rig)
    rig.set("param.features", _features("FRICTION", "SPEED_FORWARD", "ACCELERATION_FORWARD"), _features("FRICTION"))
    rig.set("cmd.position", 2.0, -2.0)
    rig.run(0.05)
    rig.set("param.features", _features("SPEED_FORWARD", "SPEED_OBSERVER"), _features("ACCELERATION_FORWARD"))
    rig.set("cmd.mode", POSITION, SPEED)
    rig.set("cmd.speed", 0.0, 100.0)
    rig.set("cmd.position", 0.0)
    rig.run(0.03)
    rig.set("param.features", _features("SPEED_FORWARD", "FOLLOWING_ERROR"), _features("OVER_SPEED"))
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
    _spin(rig)
    rig.set("param.features", _features("POSITION_LIMITS"))
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
    rig.set("param.features", _features())
    rig.run(0.002)


_OBSERVER: Final = 1


def _sensorless(rig: Rig, *speeds: float) -> None:
    """Both axes without their encoders, enabled with speed set-points."""
    rig.set_raw("param.feedback", _OBSERVER, _OBSERVER)
    _ready(rig)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.enable", 1)
    rig.until("READY on both axes", lambda: rig.places() == ["READY", "READY"])
    rig.set("cmd.speed", *speeds)


def sensorless(rig: Rig) -> None:
    """Without encoders: start both ways, caught on the fly, every mode, below the minimum, off."""
    _sensorless(rig, 80.0, -60.0)
    rig.until("both spin", lambda: rig.places() == ["SPIN", "SPIN"])
    rig.run(0.03)
    rig.set("param.features", _features("OVER_SPEED"), _features())
    rig.set("param.over_speed", 5.0)
    rig.until("too fast", lambda: "OVER_SPEED" in rig.faults(0))
    rig.set("param.features", _features())
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
    rig.set("param.features", _features(), _features("OVER_SPEED"))
    rig.until("too fast", lambda: "OVER_SPEED" in rig.faults(1))
    rig.set("param.features", _features())
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
    _stop(rig)


def sensorless_lost(rig: Rig) -> None:
    """A shaft that is held at speed, and from the beginning."""
    _sensorless(rig, -80.0, 0.0)
    rig.until("axis 1 spins", lambda: rig.places()[0] == "SPIN")
    rig.run(0.02)
    rig.lock(0)
    rig.until("stall seen", lambda: rig.faults(0) == ["SPEED_FEEDBACK"])
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("axis 1 cleared", lambda: rig.places()[0] == "STOP")
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
    """The observer beside the encoders: one dies while its shaft turns."""
    _spin(rig)
    rig.set("param.features", _features("ANGLE_CHECK"))
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 80.0, -80.0)
    rig.run(0.06)
    rig.set("param.features", _features("ANGLE_CHECK"), _features())
    rig.plug(0, False)
    rig.run(0.0015)
    rig.plug(0, True)
    rig.run(0.01)
    rig.plug(0, False)
    rig.until("encoder caught out", lambda: "ANGLE_MISMATCH" in rig.faults(0))
    rig.run(0.005)


def braking(rig: Rig) -> None:
    """Braking current folded back on a small capacitor, in every mode."""
    _spin(rig)
    rig.set("param.acceleration_limit", 50_000.0)
    rig.set("param.features", _features("FOLLOWING_ERROR"))
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 300.0, -300.0)
    rig.run(0.02)
    rig.set("cmd.mode", POSITION, TORQUE)
    rig.set("cmd.i_q", 0.0, 3.0)
    rig.run(0.01)
    rig.set("cmd.enable", 0)
    rig.run(0.01)


def resistor(rig: Rig) -> None:
    """A supply that is too high, and a resistor until its budget is spent."""
    _ready(rig)
    rig.set_raw("param.brake", 2)  # is no switch
    rig.run(0.002)
    rig.set_raw("param.brake", 1)
    rig.supply(35.4)
    rig.until("the resistor's budget is spent", lambda: "OVER_VOLTAGE" in rig.faults(0))


def shorted(rig: Rig) -> None:
    """Shorted windings, wanted again meanwhile, until the shaft rests."""
    _ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.places()[0] == "SPIN")
    rig.set_raw("param.on_disable", SHORT, 4)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 20.0)
    rig.run(0.01)
    rig.set("cmd.enable", 0)
    rig.run(0.002)
    rig.set("cmd.enable", 1, 0)
    rig.until("ALIGN after a short", lambda: rig.places()[0] == "ALIGN")


def overloaded(rig: Rig) -> None:
    """A quick stop by shorted windings that carry more than they may."""
    _ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.places()[0] == "SPIN")
    rig.set_raw("param.on_quick_stop", SHORT, 65535)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", -100.0)
    rig.run(0.03)
    rig.set("cmd.enable", 0)
    rig.run(0.001)
    rig.set("cmd.quick_stop", 1)  # is harsher
    rig.run(0.001)
    rig.disturb(0, one_in=1)  # codes that make no sense
    rig.run(0.002)
    rig.calm()


def held(rig: Rig) -> None:
    """A position held without a drive; a quick stop that withdraws it."""
    _ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.places()[0] == "SPIN")
    rig.set_raw("param.on_disable", HOLD, RAMP)
    rig.set_raw("param.on_quick_stop", RAMP, RAMP)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 40.0)
    rig.run(0.015)
    rig.set("cmd.enable", 0)
    rig.run(0.025)
    rig.set("cmd.enable", 1, 0)
    rig.set("cmd.speed", 40.0)
    rig.run(0.015)
    rig.set("cmd.quick_stop", 1)
    rig.run(0.02)


def too_fast_for_a_short(rig: Rig) -> None:
    """The windings would carry too much: the axis coasts. Before that, a look at every monitor output."""
    _ready(rig)
    for quantity in range(1, 19):
        rig.set_raw("param.monitor", quantity, quantity)
        rig.run(0.001)
    rig.set_raw("param.monitor", 0, 0)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.places()[0] == "SPIN")
    rig.set_raw("param.on_quick_stop", COAST, COAST)
    rig.set_raw("param.on_disable", SHORT, SHORT)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 170.0)
    rig.run(0.05)
    rig.set("cmd.enable", 0)
    rig.run(0.002)
    rig.supply(36.0)
    rig.until("over-voltage while it coasts", lambda: "OVER_VOLTAGE" in rig.faults(0))


def broken_phases(rig: Rig) -> None:
    """Phases lost while they turn and while they hold a load; a converter that repeats itself, or says too much."""
    _spin(rig)
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
    rig.until("second thoughts", lambda: rig.faults(0) == ["CURRENT_SENSE"])
    rig.heal(CurrentNoise(0, 0.02))
    rig.heal(OpenPhase(0, "a"))
    rig.heal(StuckConverter(0, "c", 2100))
    rig.heal(StuckConverter(1, "b", 2150))
    rig.lock(0)
    rig.lock(1)
    rig.set("cmd.clear_faults", 1)
    rig.until("both axes cleared", lambda: rig.places() == ["STOP", "STOP"])


def broken_encoders(rig: Rig) -> None:
    """A line dead, both lines dead, and a core that stands still: once for a moment, once until the watchdog barks."""
    _spin(rig)
    rig.set("param.faults_enabled", _ALL_FAULTS)
    rig.set("cmd.mode", SPEED, TORQUE)
    rig.set("cmd.speed", 100.0, 0.0)
    rig.set("cmd.i_q", 0.0, 0.3)
    rig.run(0.05)
    rig.inject(StuckLine(0, "A"))
    rig.plug(1, False)
    rig.until("lines missed", lambda: all("ENCODER_LOST" in rig.faults(k) for k in (0, 1)))
    rig.inject(HotPowerStage(0, 120.0))
    rig.until("heat", lambda: "OVER_TEMPERATURE" in rig.faults(0))
    rig.set("cmd.clear_faults", 1)
    rig.heal(HotPowerStage(0, 120.0))
    rig.run(0.01)
    rig.inject(StalledCore(0.001))
    rig.until("late loops", lambda: "LATE_LOOP" in rig.faults(1))
    rig.inject(StalledCore(0.2))
    rig.run(0.06)
    rig.until("watchdog", lambda: "WATCHDOG" in rig.faults(0))


def server(rig: Rig) -> None:
    """Every FreeMASTER request, right and wrong, to a board at rest."""
    _ready(rig)
    for frame in server_requests.frames(rig):
        rig.send(frame)


SCENARIOS: Final = (
    Scenario("start-to-stop", _plant((math.pi / 8, -3 * math.pi / 8)), start_to_stop),
    Scenario("second-thoughts", _plant(), second_thoughts),
    Scenario("once-more", _plant(), once_more),
    Scenario("extremes", _plant(capacitance=0.05, i_break=100.0), extremes),
    Scenario("random-inputs", _plant(capacitance=0.05, i_break=100.0), random_inputs),
    Scenario("bus-faults", _plant(capacitance=1e-4), bus_faults),
    Scenario("bad-supply", _plant(), bad_supply),
    Scenario("searches", _plant(), searches),
    Scenario("reversed-encoder", _plant(), reversed_lines),
    Scenario("caught", _plant(), caught),
    Scenario("stalled", _plant(), stalled),
    Scenario("lost-index", _plant(), lost_index),
    Scenario("over-current", _plant(i_break=4.5), over_current),
    Scenario("wrong-offset", _plant(i_offset=(0.0, 2.0, 0.0)), wrong_offset),
    Scenario("forward", _plant(), forward),
    Scenario("soft-limits", _plant(), soft_limits),
    Scenario("sensorless", _plant(capacitance=0.05), sensorless),
    Scenario("sensorless-lost", _plant(i_noise=0.0).with_bus(u_noise=0.0), sensorless_lost),
    Scenario("slipped-encoder", _plant(capacitance=0.05), slipped),
    Scenario("braking", _plant(capacitance=0.5e-3), braking),
    Scenario("resistor", _plant(), resistor),
    Scenario("shorted", _plant(), shorted),
    Scenario("overloaded", _plant(), overloaded),
    Scenario("held", _plant(), held),
    Scenario("too-fast-for-a-short", _plant(), too_fast_for_a_short),
    Scenario("broken-phases", _plant(), broken_phases),
    Scenario("broken-encoders", _plant(), broken_encoders),
    Scenario("server", _plant(), server),
)
