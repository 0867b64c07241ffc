"""The twin of an axis whose position is set, or homed at a hard stop that the twin's plant does not have."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_twin.plant import PlantConfig
from twin_rig import TwinRig, apart, worst_counts

CATALOGUE = Catalogue.load()
METHOD, STATE = (CATALOGUE.enums[name] for name in ("home_method_t", "home_state_t"))
HERE, ASSUME, STOP = (METHOD[name] for name in ("HERE", "ASSUME", "STOP_POSITIVE"))


def with_end_stops(seed: int, away: float) -> PlantConfig:
    """Plant with end stops at the distance `away` on both sides of the start angles [rad]."""
    plant = PlantConfig.load().drawn(seed)
    for axis, entry in enumerate(plant.axes):
        assert not isinstance(entry.theta_start, str)
        low, high = entry.theta_start - away, entry.theta_start + away
        damping = 0.4 * math.sqrt(20.0 * entry.inertia)
        plant = plant.with_axis(axis, stop_min=low, stop_max=high, stop_stiffness=20.0, stop_damping=damping)
    return plant


@pytest.mark.parametrize("method", [HERE, ASSUME])
@pytest.mark.parametrize("held", [False, True])
def test_a_set_position_is_set_on_both_boards(held: bool, method: int) -> None:
    with TwinRig() as rig:
        if held:
            rig.enable_axes()
        else:
            rig.run(0.2)
        rig.write("cmd.home_position", [100.0, -2000.0])
        rig.run(0.01)
        rig.write("cmd.home", [method, method])
        pairs = rig.run(0.1)
        assert pairs[-1].real["axis1.position"] == pytest.approx(100.0, abs=2e-3)
        assert pairs[-1].twin["axis1.home_state"] == pairs[-1].real["axis1.home_state"] != 0
        if not held:
            rig.enable_axes()
        rig.write("cmd.position", [104.0, -2003.0])
        pairs += rig.run(0.8)
        assert worst_counts(pairs) <= (8 if held else 60), "a rotor search moves the shafts differently"
        assert worst_counts(pairs[-20:]) <= 4.01
        assert pairs[-1].real["axis2.position"] == pytest.approx(-2003.0, abs=4e-3)
        assert rig.twin.synchronisations == 1


def test_the_position_of_a_homed_axis_is_adopted() -> None:
    with TwinRig(plant=with_end_stops(1, 1.0)) as rig:
        rig.enable_axes()
        rig.write("cmd.home_position", [10.0, 0.0])
        rig.run(0.01)
        rig.write("cmd.home", [STOP, 0], mask=1)
        pairs = rig.run(4.0)
        assert rig.real.raw["axis1.home_state"] == STATE["KNOWN"]
        assert "axis1 is being homed" in apart(pairs)
        assert not rig.twin.status
        pairs = rig.run(0.2)
        assert pairs[-1].twin["axis1.home_state"] == STATE["KNOWN"]
        assert pairs[-1].twin["axis2.home_state"] == STATE["UNKNOWN"]
        rig.write("cmd.position", [8.0, 0.5])
        pairs = rig.run(0.8)
        assert not apart(pairs)
        assert worst_counts(pairs) <= 8, "in motion, with another rotor angle"
        assert worst_counts(pairs[-20:]) <= 4.01
        assert pairs[-1].real["axis1.position"] == pytest.approx(8.0, abs=4e-3)


def test_a_resynchronised_twin_has_the_home_state_of_the_board() -> None:
    with TwinRig() as rig:
        rig.enable_axes()
        rig.write("cmd.home_position", [1.0, 2.0])
        rig.run(0.01)
        rig.write("cmd.home", [HERE, HERE])
        rig.run(0.1)
        rig.twin.resync("asked for")
        pairs = rig.run(2.0)
        assert pairs[-1].twin["axis2.home_state"] == STATE["KNOWN"]
        assert worst_counts(pairs[-20:]) <= 4.01


def test_stops_of_a_plant_are_in_order() -> None:
    plant = PlantConfig.load()
    with pytest.raises(ValueError, match=r"stop_min: 2\.0 is above stop_max = 1\.0"):
        plant.with_axis(0, stop_min=2.0, stop_max=1.0)
    with pytest.raises(ValueError, match=r"axis2\.stop_stiffness: 10000\.0 N m/rad is too large"):
        replace(plant.with_axis(1, stop_stiffness=10_000.0))
