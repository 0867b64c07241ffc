"""Every stop category, and braking energy on the DC bus."""

from __future__ import annotations

from targets.rig import Rig
from targets.scenarios.parts import COAST, HOLD, POSITION, RAMP, SHORT, SPEED, TORQUE, features, ready, spin


def braking(rig: Rig) -> None:
    """Limited braking current with a small bus capacitor, in every mode."""
    spin(rig)
    rig.set("param.acceleration_limit", 50_000.0)
    rig.set("param.features", features("FOLLOWING_ERROR"))
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 300.0, -300.0)
    rig.run(0.02)
    rig.set("cmd.mode", POSITION, TORQUE)
    rig.set("cmd.i_q", 0.0, 3.0)
    rig.run(0.01)
    rig.set("cmd.enable", 0)
    rig.run(0.01)


def resistor(rig: Rig) -> None:
    """Over-voltage of the supply with the braking resistor, until its energy budget is used up."""
    ready(rig)
    rig.set_raw("param.brake", 2)  # refused: not a switch
    rig.run(0.002)
    rig.set_raw("param.brake", 1)
    rig.set_supply(35.4)
    rig.until("the energy budget of the resistor is used up", lambda: "OVER_VOLTAGE" in rig.faults(0))


def shorted(rig: Rig) -> None:
    """Stop by shorted windings, with an enable during the stop."""
    ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.states()[0] == "SPIN")
    rig.set_raw("param.on_disable", SHORT, 4)  # refused
    rig.set_raw("param.on_disable", SHORT, RAMP)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 20.0)
    rig.run(0.01)
    rig.set("cmd.enable", 0)
    rig.run(0.002)
    rig.set("cmd.enable", 1, 0)
    rig.until("ALIGN after a short", lambda: rig.states()[0] == "ALIGN")


def overloaded(rig: Rig) -> None:
    """A quick stop by shorted windings with too much current."""
    ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.states()[0] == "SPIN")
    rig.set_raw("param.on_quick_stop", SHORT, HOLD)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", -100.0)
    rig.run(0.03)
    rig.set("cmd.enable", 0)
    rig.run(0.001)
    rig.set("cmd.quick_stop", 1)  # stronger stop category
    rig.run(0.001)
    rig.disturb(0, one_in=1)  # random codes
    rig.run(0.002)
    rig.end_disturbance()


def held(rig: Rig) -> None:
    """Position hold after disable; a quick stop that ends it."""
    ready(rig)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.states()[0] == "SPIN")
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
    """Coasting, as the current of shorted windings would be too large; before it, every monitor output."""
    ready(rig)
    for quantity in range(1, 19):
        rig.set_raw("param.monitor", quantity, quantity)
        rig.run(0.001)
    rig.set_raw("param.monitor", 0, 0)
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN on axis 1", lambda: rig.states()[0] == "SPIN")
    rig.set_raw("param.on_quick_stop", COAST, COAST)
    rig.set_raw("param.on_disable", SHORT, SHORT)
    rig.set("cmd.mode", SPEED)
    rig.set("cmd.speed", 170.0)
    rig.run(0.05)
    rig.set("cmd.enable", 0)
    rig.run(0.002)
    rig.set_supply(36.0)
    rig.until("over-voltage while it coasts", lambda: "OVER_VOLTAGE" in rig.faults(0))
