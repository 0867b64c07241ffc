"""Switches, enable input and holding brake of both axes."""

from __future__ import annotations

import math
from dataclasses import replace

from servo_msgs_py.axis_config_transfer import read_block, send_configuration
from servo_twin.fault_injection import CutWire
from servo_twin.plant import PlantConfig

from targets.rig import Rig
from targets.scenarios.parts import HOLD, POSITION, SPEED, TEST, plant, ready

_EVERYTHING = 31
_TICKS = 8


def wired() -> PlantConfig:
    """Plant with limit switches on both sides, home switches in between, and fast brakes."""
    both = plant((math.pi / 4, 0.5 * math.pi))  # axis 2: opposite to the first vector
    for axis, entry in enumerate(both.axes):
        pins = replace(
            entry.pins, home_from=1.0, home_to=3.0, limit_min=-5.0, limit_max=7.0, brake_torque=0.1,
            brake_open_time=0.002, brake_close_time=0.002,
        )  # fmt: skip
        both = both.with_axis(axis, pins=pins)
    return both


def _fit(rig: Rig) -> None:
    fitted = {"pins.fitted": _EVERYTHING, "pins.open_ticks": _TICKS, "pins.close_ticks": _TICKS}
    blocks = [{**block, **fitted} for block in (read_block(rig, axis) for axis in (0, 1))]
    for block in blocks:
        block["rotor_search.current_step"] *= 4
    send_configuration(rig, dict(enumerate(blocks)))
    rig.run(0.005)


def pins(rig: Rig) -> None:
    """A search under load, a limit switch in motion, stops with the holding brake, an open enable input."""
    ready(rig)
    _fit(rig)
    rig.set("cmd.mode", TEST)  # refused with a holding brake
    rig.set("cmd.enable", 1)
    rig.run(0.002)
    rig.until("STOP again", lambda: rig.states() == ["STOP", "STOP"])
    rig.set("cmd.mode", POSITION)
    rig.inject(CutWire(1, "enable"))
    rig.run(0.002)
    rig.set_load(0, 0.02)
    rig.set("cmd.enable", 1)  # refused by axis 2
    rig.until("axis 1 in SPIN", lambda: rig.states() == ["SPIN", "STOP"])
    rig.clear_fault(CutWire(1, "enable"))
    rig.set("cmd.mode", SPEED, POSITION)
    rig.set("cmd.speed", 100.0, 0.0)  # the brake may still be closed
    rig.run(0.01)
    rig.set("cmd.speed", 100.0, 0.0)
    rig.until("the limit switch", lambda: "LIMIT_SWITCH" in rig.faults(0))
    rig.until("its stop", lambda: rig.states()[0] == "FAULT")
    rig.set("cmd.clear_faults", 1)
    rig.until("axis 1 in STOP", lambda: rig.states()[0] == "STOP")
    rig.run(0.09)
    rig.set("cmd.enable", 1)
    rig.until("axis 1 in SPIN again", lambda: rig.states()[0] == "SPIN")
    rig.set("cmd.speed", -30.0, 0.0)  # the brake is still closed
    rig.until("both in SPIN", lambda: rig.states() == ["SPIN", "SPIN"])
    rig.run(0.01)
    rig.set("cmd.speed", -30.0, 0.0)
    rig.run(0.02)
    rig.set("param.on_disable", HOLD)
    rig.set("cmd.enable", 0, 0)
    rig.run(0.02)
    rig.set("cmd.enable", 0, 1)  # axis 2 is enabled again
    rig.run(0.02)
    rig.inject(CutWire(1, "enable"))
    rig.until("enable input", lambda: "ENABLE_INPUT" in rig.faults(1))
    rig.inject(CutWire(0, "limit_min"))
    rig.inject(CutWire(0, "limit_max"))
    rig.run(0.01)


def failed_searches(rig: Rig) -> None:
    """Failed rotor searches: dead encoder, reversed encoder, load too large, open motor cable."""
    ready(rig)
    _fit(rig)
    rig.connect_encoder(0, False)
    rig.reverse_encoder(1)
    rig.set("cmd.enable", 1)
    rig.until("both failed", lambda: rig.states() == ["FAULT", "FAULT"])
    rig.connect_encoder(0, True)
    rig.reverse_encoder(1)
    rig.set_load(0, 0.1)
    rig.connect_motor(1, False)
    rig.set("cmd.clear_faults", 1)
    rig.until("both cleared", lambda: rig.states() == ["STOP", "STOP"])
    rig.run(0.09)
    rig.set("cmd.enable", 1)
    rig.until("axis 1 load too large, axis 2 open cable", lambda: rig.states() == ["FAULT", "FAULT"])
    rig.run(0.01)
