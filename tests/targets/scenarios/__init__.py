"""Recorded scenarios: together they cover every state, mode, fault and limit of the firmware.

Each starts with a board after power-on and is short: the simulator of a microcontroller needs 3 s per simulated second.
"""

from __future__ import annotations

import math
from typing import Final

from targets import server_requests
from targets.recording import Scenario
from targets.rig import Rig
from targets.scenarios import excitation, faults, homing, moves, observers, pins, stops, storage, tuning
from targets.scenarios.parts import plant, ready


def server(rig: Rig) -> None:
    """Every FreeMASTER request, valid and invalid, to a board at rest."""
    ready(rig)
    for frame in server_requests.frames(rig):
        rig.send(frame)


SCENARIOS: Final = (
    Scenario("start-to-stop", plant((math.pi / 8, -3 * math.pi / 8)), moves.start_to_stop),
    Scenario("reenabled", plant(), moves.reenabled),
    Scenario("second-alignment", plant(), moves.second_alignment),
    Scenario("extremes", plant(capacitance=0.05, i_break=100.0), moves.extremes),
    Scenario("random-inputs", plant(capacitance=0.05, i_break=100.0), faults.random_inputs),
    Scenario("bus-faults", plant(capacitance=1e-4), faults.bus_faults),
    Scenario("bad-supply", plant(), faults.bad_supply),
    Scenario("searches", plant(), faults.searches),
    Scenario("reversed-encoder", plant(), faults.reversed_lines),
    Scenario("caught", plant(), faults.caught),
    Scenario("stalled", plant(), faults.stalled),
    Scenario("backlash", plant(), faults.backlash),
    Scenario("shaken", plant(), faults.shaken),
    Scenario("slipped-discs", plant(friction=0.04), faults.slipped_discs),
    Scenario("silent-encoder", plant(), faults.silent_encoder),
    Scenario("quiet-losses", plant(), faults.quiet_losses),
    Scenario("lost-index", plant(), faults.lost_index),
    Scenario("over-current", plant(i_break=4.5), faults.over_current),
    Scenario("wrong-offset", plant(i_offset=(0.0, 2.0, 0.0)), faults.wrong_offset),
    Scenario("forward", plant(), moves.forward),
    Scenario("soft-limits", plant(), moves.soft_limits),
    Scenario("expired", plant(), moves.expired),
    Scenario("trajectory", plant(), moves.trajectory),
    Scenario("field-weakening", plant(capacitance=2e-4), moves.field_weakening),
    Scenario("sensorless", plant(capacitance=0.05), observers.sensorless),
    Scenario("sensorless-lost", plant(i_noise=0.0).with_bus(u_noise=0.0), observers.sensorless_lost),
    Scenario("slipped-encoder", plant(capacitance=0.05), observers.slipped),
    Scenario("braking", plant(capacitance=0.5e-3), stops.braking),
    Scenario("resistor", plant(), stops.resistor),
    Scenario("shorted", plant(), stops.shorted),
    Scenario("overloaded", plant(), stops.overloaded),
    Scenario("held", plant(), stops.held),
    Scenario("too-fast-for-a-short", plant(), stops.too_fast_for_a_short),
    Scenario("broken-phases", plant(), faults.broken_phases),
    Scenario("broken-encoders", plant(), faults.broken_encoders),
    Scenario("tuning", plant(), tuning.tuning),
    Scenario("hot-winding", plant(), tuning.hot_winding),
    Scenario("measured", plant(), tuning.measured),
    Scenario("positions", plant(), homing.positions),
    Scenario("torque-ripple", plant(), homing.torque_ripple),
    Scenario("homing", plant(), homing.homing),
    Scenario("blocked", plant(), homing.blocked),
    Scenario("storage", plant(), storage.storage),
    Scenario("pins", pins.wired(), pins.pins),
    Scenario("failed-searches", pins.wired(), pins.failed_searches),
    Scenario("imposed", plant(), excitation.imposed),
    Scenario("excited", plant(), excitation.signals),
    Scenario("server", plant(), server),
)
