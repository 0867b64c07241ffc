"""The DC bus: charging through the resistance of the source; no current back into the source."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from native_library import Native, c_bus
from servo_twin.plant import BusPlant, PlantConfig

STEP = 15.625e-6


@pytest.fixture
def bus_plant() -> BusPlant:
    return PlantConfig.load().bus


def make(plant_c: Native, bus_plant: BusPlant) -> Any:
    bus = plant_c.ffi.new("supply_t *")
    plant_c.lib.supply_init(bus, c_bus(plant_c, bus_plant), 25.0)
    return bus


def test_bus_is_charged_at_the_start(plant_c: Native, bus_plant: BusPlant) -> None:
    bus = make(plant_c, bus_plant)
    assert bus.u == 24.0
    plant_c.lib.supply_advance(bus, STEP, 0.0)
    assert bus.u == 24.0


def test_a_load_discharges_the_bus_exponentially(plant_c: Native, bus_plant: BusPlant) -> None:
    bus = make(plant_c, bus_plant)
    for _ in range(30):
        plant_c.lib.supply_advance(bus, STEP, 8.0)
    time_constant = bus_plant.r_source * bus_plant.capacitance
    assert bus.u == pytest.approx(24.0 - 0.8 * (1 - math.exp(-30 * STEP / time_constant)), rel=1e-9)


def test_braking_current_stays_in_the_capacitor(plant_c: Native, bus_plant: BusPlant) -> None:
    bus = make(plant_c, bus_plant)
    for _ in range(1000):
        plant_c.lib.supply_advance(bus, STEP, -2.0)
    charged = 24.0 + 2.0 * 1000 * STEP / bus_plant.capacitance
    assert bus.u == pytest.approx(charged, rel=1e-9)
    for _ in range(1000):
        plant_c.lib.supply_advance(bus, STEP, 0.0)
    assert bus.u == pytest.approx(charged, rel=1e-9)


def test_a_source_that_is_switched_off_leaves_the_charge(plant_c: Native, bus_plant: BusPlant) -> None:
    bus = make(plant_c, bus_plant)
    plant_c.lib.supply_set(bus, 0.0)
    for _ in range(470):
        plant_c.lib.supply_advance(bus, STEP, 1.0)
    assert bus.u == pytest.approx(24.0 - 470 * STEP / bus_plant.capacitance, rel=1e-9)
    for _ in range(20000):
        plant_c.lib.supply_advance(bus, STEP, 1.0)
    assert bus.u == 0.0


@pytest.mark.parametrize(("start", "load"), [(8.0, -25.0), (-8.0, 25.0)])
def test_crossing_the_voltage_of_the_source(plant_c: Native, bus_plant: BusPlant, start: float, load: float) -> None:
    """One step across the source voltage agrees with a thousand small steps."""
    small = plant_c.ffi.new("supply_t *")
    bus_plant = dataclasses.replace(bus_plant, r_source=0.02)
    plant_c.lib.supply_init(small, c_bus(plant_c, bus_plant), 25.0)
    big = make(plant_c, bus_plant)
    for _ in range(30):
        plant_c.lib.supply_advance(big, STEP, start)
    for current, steps in [(load, 3), (0.0, 2), (load, 2)]:
        for _ in range(steps):
            small.u = big.u
            plant_c.lib.supply_advance(big, STEP, current)
            for _ in range(1000):
                plant_c.lib.supply_advance(small, STEP / 1000, current)
            assert big.u == pytest.approx(small.u, abs=2e-4)


@settings(deadline=None, derandomize=True)
@given(loads=st.lists(st.floats(-30, 30), min_size=1, max_size=60), resistance=st.floats(1e-3, 10))
def test_source_current_is_not_negative_and_limited(plant_c: Native, loads: list[float], resistance: float) -> None:
    bus_plant = dataclasses.replace(PlantConfig.load().bus, r_source=resistance)
    bus = make(plant_c, bus_plant)
    for load in loads:
        before = bus.u
        plant_c.lib.supply_advance(bus, STEP, load)
        source = bus_plant.capacitance * (bus.u - before) / STEP + load
        lowest = min(before, bus.u)
        assert source >= -1e-6
        assert source <= max(24.0 - lowest, 0.0) / resistance + 1e-6 or bus.u == 0.0
