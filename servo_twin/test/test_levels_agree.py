"""Both levels of the board agree: some experiments, and cases in which they differed once."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from servo_msgs_py.board_port import choose, write_axis
from servo_msgs_py.units import TICK
from servo_twin.board import Board
from servo_twin.fault_injection import StalledCore
from servo_twin.level import Level
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import braking, fault_matrix, levels, rotor_search, start_up
from servo_twin.validation.experiments.command import run_experiments
from servo_twin.validation.experiments.rig import at_level, spinning
from servo_twin.validation.timing.trace import Kind

LEVELS: tuple[Level, ...] = ("ideal", "registers")
PLANT = PlantConfig.load()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path-filter", "mt-speed", "anti-windup"])
def test_experiments_agree_at_both_levels(name: str) -> None:
    ideal, registers = (run_experiments([name], PLANT, 1, quiet=True, level=level)[0] for level in LEVELS)
    pairs = levels.pairs(ideal, registers)
    assert len(pairs) >= 6
    assert [pair.figure for pair in pairs if not pair.agrees] == []


@pytest.mark.parametrize("level", LEVELS)
def test_rotor_search_agrees_on_a_shaft_with_high_friction(level: Level) -> None:
    """With the rotor aligned to the axis of a phase, the current of another phase stays zero within rounding."""
    stiff = PLANT
    for number, entry in enumerate(PLANT.axes):
        stiff = stiff.with_axis(number, friction=3.0 * entry.friction)
    with at_level(level):
        for search, axis in zip(rotor_search.find(rotor_search.start_at(stiff, 90.0), 55), stiff.axes, strict=True):
            assert search.faults == frozenset()
            assert search.error is not None
            assert abs(search.error) <= rotor_search.error_bound(axis, search.current)


@pytest.mark.parametrize("level", LEVELS)
def test_shaft_at_rest_on_an_edge_is_not_detected_as_dead_line(level: Level) -> None:
    """The search holds the rotor of axis 2 on an edge for 0.4 s, with 4 A on the d axis."""
    other = PLANT.with_axis(0, l_d=0.5 * PLANT.axes[0].l_d, l_q=0.5 * PLANT.axes[0].l_q)
    with at_level(level), spinning(other, 1) as board:
        assert board.read_words("axis2.faults")[0] == 0


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("state", "seed"), [("STOP", 199), ("CALIB", 200)])
def test_stall_of_the_core_for_a_millisecond_is_a_late_loop(level: Level, state: str, seed: int) -> None:
    """The sequence of the two loops restarts, independent of the duties at that time."""
    fault_case = next(d for d in fault_matrix.fault_cases(PLANT) if d.name == "core stands still 1 ms")
    with at_level(level):
        found = fault_matrix.case(PLANT, seed, fault_case, state)
    assert (found.name, found.other) == ("LATE_LOOP", True)
    assert found.periods in (24, 32), "the supervision runs once per slow tick"


EDGE_HANDLERS = (24, 28)  # vectors of channel 0 of both timers


@contextmanager
def turning() -> Iterator[Board]:
    with at_level("registers"), spinning(PLANT, 1) as board:
        choose(board, "cmd.mode", 0, "SPEED")
        write_axis(board, "cmd.speed", 0, 100.0)
        board.run(0.1)
        yield board


def test_stalled_core_is_late_with_any_next_handler() -> None:
    """The stall must not be charged to the handler of an edge: the loops would interrupt that handler."""
    with turning() as board:
        while True:
            before = board.time_ns
            events = board.trace(before + 1000, capacity=100)
            if np.any((events["kind"] == Kind.ENTER) & np.isin(events["a"], EDGE_HANDLERS)):
                break
    with turning() as board:
        board.advance(before)
        board.inject(StalledCore(0.001))
        board.run(0.003)
        assert board.read_words("axis1.faults")[0] & board.catalogue.flag("faults", "LATE_LOOP").mask


@pytest.mark.parametrize("level", LEVELS)
def test_no_hand_over_of_a_shaft_at_standstill(level: Level) -> None:
    """The residual voltage of dead time and damping current looks like a back-EMF for a moment and locks the PLL."""
    stuck = PLANT
    for axis in range(2):
        stuck = stuck.with_axis(axis, friction=10.0)
    with at_level(level):
        starts = start_up.start(stuck, 5, start_up.draws(1, 6)[3])
    assert [(start.end, start.criterion) for start in starts] == [("START_UP", None)] * 2


@pytest.mark.parametrize("level", LEVELS)
def test_shorted_windings_return_no_energy_to_the_bus(level: Level) -> None:
    """With the small capacitor 0.5 J would raise the bus far above its limit, which would end the short."""
    plant = PLANT.with_bus(capacitance=0.3e-3).with_axis(0, inertia=2.4e-5)
    motor = plant.axes[0]
    with at_level(level):
        omega, current = braking.short(plant, 3, 0, 120.0, 0.15)
    speeds = np.abs(omega)
    formula = np.array([braking.short_current(motor, w, drops=True) for w in speeds])
    settled = np.arange(speeds.size) * TICK > braking.SETTLED * motor.l_q / motor.r_s
    assert np.count_nonzero(settled) > 20
    harmonics = 4.0 / math.pi * motor.v_drop * (1.0 / 5.0 + 1.0 / 7.0) / (motor.r_s + motor.r_on)
    assert np.abs(current - formula)[settled].max() < 0.05 * formula.max() + harmonics
