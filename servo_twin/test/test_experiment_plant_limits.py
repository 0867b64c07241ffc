"""Limits of a plant, nominal values of the controller, and runs that end in a fault."""

from __future__ import annotations

import math

import numpy as np
import pytest
from servo_msgs_py.board_port import choose, write_axis
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import plant_limits
from servo_twin.validation.experiments.plant_limits import (
    Demand,
    differences,
    move_speeds,
    nominal_shafts,
    path_demands,
    top_speed,
)
from servo_twin.validation.experiments.rig import COUNT, record, shaft_counts, spinning

SPEED = 314.0


@pytest.fixture(scope="module")
def plant() -> PlantConfig:
    return PlantConfig.load()


def both(plant: PlantConfig, **factors: float) -> PlantConfig:
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, **{name: factor * getattr(entry, name) for name, factor in factors.items()})
    return plant


@pytest.mark.parametrize("factors", [{}, {"friction": 0.3, "inertia": 2.0}])
def test_nominal_shaft_does_not_depend_on_the_plant(plant: PlantConfig, factors: dict[str, float]) -> None:
    """The packaged configuration has the nominal values of the packaged plant."""
    for entry, nominal in zip(plant.axes, nominal_shafts(both(plant, **factors), 3), strict=True):
        assert nominal.inertia == pytest.approx(entry.inertia, rel=0.01)
        assert nominal.friction == pytest.approx(entry.friction + plant_limits.PROBE_SPEED * entry.viscous, rel=0.01)


def test_nominal_shaft_with_a_stronger_motor(plant: PlantConfig) -> None:
    nominal = nominal_shafts(both(plant, psi_m=1.2), 3)[0]
    assert nominal.inertia == pytest.approx(1.2 * plant.axes[0].inertia, rel=0.01)


def test_nominal_shaft_is_measured_with_a_smaller_step(plant: PlantConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Inertia from a smaller step where the current limit hides it; friction from the large step."""
    genuine, steps = plant_limits._first_current, []

    def first_current(plant: PlantConfig, seed: int, switch: str | None, speed: float) -> list[float]:
        steps.append(speed)
        if switch == "ACCELERATION_FORWARD" and speed > 0.6:
            raise SimulationError("the current limit hides it")
        return genuine(plant, seed, switch, speed)

    monkeypatch.setattr(plant_limits, "_first_current", first_current)
    for entry, nominal in zip(plant.axes, nominal_shafts(plant, 3), strict=True):
        assert nominal.inertia == pytest.approx(entry.inertia, rel=0.02)
    assert min(steps) == 0.5


def test_the_nominal_shaft_is_not_measurable_with_a_low_current_limit(
    plant: PlantConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plant_limits, "PROBE_SPEED", 20.0)
    monkeypatch.setattr(plant_limits, "PROBE_HALVINGS", 1)
    with pytest.raises(SimulationError, match="current limit"):
        nominal_shafts(plant, 3)


def test_path_needs_half_of_the_current(plant: PlantConfig) -> None:
    for entry, demand in zip(plant.axes, path_demands(plant, 3), strict=True):
        needed = entry.inertia * demand.acceleration_per_speed * SPEED / entry.torque_constant
        # Less by the time in which the ramp reaches its speed with the largest param.acceleration_limit.
        assert needed == pytest.approx(0.5 * demand.current, rel=0.04)


class TestTopSpeed:
    def test_top_speed_of_the_packaged_plant(self, plant: PlantConfig) -> None:
        speeds, note = move_speeds(plant, 3, together=True)
        assert speeds == pytest.approx([SPEED] * 2, rel=1e-4)
        assert note == ""

    def test_speed_limits_reduced_for_a_large_inertia(self, plant: PlantConfig) -> None:
        speeds, note = move_speeds(both(plant, inertia=3.0), 3, together=False)
        assert all(0.3 * SPEED < speed < 0.7 * SPEED for speed in speeds)
        assert "reduced" in note

    def test_energy_limit_of_the_bus(self, plant: PlantConfig) -> None:
        small = plant.with_bus(capacitance=1e-3)
        speed = top_speed(small, [0, 1], SPEED)
        energy = 0.5 * (plant.axes[0].inertia + plant.axes[1].inertia) * speed**2
        lifted = math.sqrt(small.bus.u_source**2 + 2.0 * energy / small.bus.capacitance)
        assert lifted < plant_limits.over_voltage()
        assert lifted > plant_limits.over_voltage() - 1.0
        assert top_speed(small, [0], SPEED) > speed

    def test_a_low_supply_lowers_the_top_speed(self, plant: PlantConfig) -> None:
        low = plant.with_bus(u_source=18.0)
        speed = top_speed(low, [0], SPEED)
        emf = plant.axes[0].pole_pairs * plant.axes[0].psi_m * speed
        assert speed < SPEED
        assert 0.8 * plant_limits.modulation() * 18.0 < emf < plant_limits.modulation() * 18.0

    def test_unreachable_demand_is_refused(self, plant: PlantConfig) -> None:
        with pytest.raises(SimulationError, match="not feasible with this plant"):
            top_speed(plant, [0], SPEED, [Demand(1e5, 4.0)] * 2)


def test_differences_from_nominal_values_as_text(plant: PlantConfig) -> None:
    assert differences(plant, 3) == ()
    notes = differences(plant.with_axis(1, inertia=5.0 * plant.axes[1].inertia), 3)
    assert len(notes) == 1
    assert "axis2: the acceleration per current is 0.2 times" in notes[0]


@pytest.mark.parametrize("may_fail", [False, True])
def test_fault_ends_the_measurement_with_an_error(plant: PlantConfig, may_fail: bool) -> None:
    with spinning(plant, 3) as board:
        board.set_supply(10.0)
        choose(board, "cmd.mode", 1, "SPEED")
        write_axis(board, "cmd.speed", 1, 200.0)
        if may_fail:
            words = record(board, [1], 1.0, may_fail=True)[1]["faults"]
            assert words[-1] & board.catalogue.flag("faults", "UNDER_VOLTAGE").mask
        else:
            with pytest.raises(SimulationError, match=r"axis\d ended in a fault. UNDER_VOLTAGE"):
                record(board, [1], 1.0)


def test_the_true_shaft_angle_is_recorded_in_counts(plant: PlantConfig) -> None:
    with spinning(plant, 3) as board:
        choose(board, "cmd.mode", 0, "SPEED")
        write_axis(board, "cmd.speed", 0, 10.0)
        recording = record(board, [0], 0.2)[0]
    assert recording["position"][-1] > 900
    # The position is latched some microseconds before the end of the tick.
    late = recording["omega"] * TICK / COUNT
    assert np.all(np.abs(shaft_counts(recording) - recording["position"] - 0.5 * late) <= 0.5 * late + 0.51)


@pytest.mark.parametrize("beyond", [-0.1, 0.1])
def test_true_position_tolerates_uneven_edges(beyond: float) -> None:
    """At the first tick an edge with an error of a tenth of a count seems to be an error of one count."""
    ticks = np.arange(200)
    theta = COUNT * np.where(ticks == 0, 7.0 - beyond, 7.0 + 3.0 * np.sin(ticks / 30.0) + 0.5)
    position = np.floor(theta / COUNT) + 100.0
    position[0] += np.sign(beyond)
    recording = Trace(TICK, {"position": position, "theta": theta, "omega": np.zeros(ticks.size)})
    assert np.all(np.abs(shaft_counts(recording) - position) <= 0.5 + abs(beyond) + 1e-9)
