"""Predictions of the tuning tool agree with the firmware on the virtual board."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from servo_msgs_py.board_port import choose, write_axis, write_word
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import PERIOD_NS, TICK
from servo_tuning.linear import spectral_radius
from servo_tuning.loops import In, Out
from servo_tuning.reading import load
from servo_tuning.tuned import Tuned, tuned
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.rig import COUNT, faults, features, record, spinning

CONFIG: Final = Path(__file__).resolve().parents[1] / "firmware" / "config" / "servo.toml"
SEED: Final = 1
BASE: Final = 100.0
"""Bias speed of the small signals [rad/s]: constant sign of the friction, frequent edges."""


@pytest.fixture(scope="module")
def axes() -> list[Tuned]:
    configuration = load(CONFIG, Catalogue.load())
    return [tuned(axis, configuration) for axis in configuration.axes]


def shaft_with(axis: int, inertia: float) -> PlantConfig:
    """Packaged plant, which has the nominal values of the configuration, with another inertia of one axis."""
    plant = PlantConfig.load()
    return plant.with_axis(axis, inertia=inertia * plant.axes[axis].inertia)


def feedback_alone(board: Board, axis: int, observed: bool = False) -> None:
    """Disable all feed-forward."""
    features(board, axis, SPEED_OBSERVER=observed, FRICTION=False, SPEED_FORWARD=False, ACCELERATION_FORWARD=False)


def critical_inertia(it: Tuned) -> float:
    """Inertia at the stability limit, relative to the nominal one; with less inertia the speed loop is unstable."""
    low, high = 0.05, 1.0
    for _ in range(30):
        middle = math.sqrt(low * high)
        if spectral_radius(it.shaft(middle, observed=False).speed_alone) < 1.0:
            high = middle
        else:
            low = middle
    return high


@pytest.mark.parametrize("axis", [0, 1])
def test_stability_limit_of_the_speed_loop_agrees_with_the_prediction(axes: list[Tuned], axis: int) -> None:
    """At constant speed the loop is stable slightly above the critical inertia, and oscillates slightly below it."""
    critical = critical_inertia(axes[axis])
    swings = []
    for inertia in (1.15 * critical, critical / 1.15):
        with spinning(shaft_with(axis, inertia), SEED) as board:
            feedback_alone(board, axis)
            faults(board, axis, OSCILLATION=False)
            choose(board, "cmd.mode", axis, "SPEED")
            write_axis(board, "cmd.speed", axis, BASE)
            part = record(board, [axis], 1.0)[axis].part(0.6)
        swings.append(float(np.ptp(part["omega"])))
    assert swings[0] < 0.1 * BASE
    assert swings[1] > 0.5 * BASE


@pytest.mark.parametrize("axis", [0, 1])
def test_deflection_by_a_load_step_in_motion_agrees_with_the_prediction(axes: list[Tuned], axis: int) -> None:
    """During a position ramp the deflection by a load step of a quarter of the rated torque is as predicted."""
    it = axes[axis]
    torque = 0.25 * it.axis.torque_constant * it.axis("motor.rated_current")
    lead, measured = 0.3, 0.2
    with spinning(PlantConfig.load(), SEED) as board:

        def move(k: int) -> None:
            write_word(board, "cmd.position", axis, round(k * TICK * BASE / COUNT))

        def load(k: int) -> None:
            move(2000 + k)
            if k == round(lead / TICK):
                board.set_load(axis, torque)

        feedback_alone(board, axis)
        record(board, [axis], 2000 * TICK, move)
        whole = record(board, [axis], lead + measured, load)[axis]
    assert not whole["limits"].any(), "a small signal"
    before, after = whole.part(0.0, lead), whole.part(lead)
    line = np.polyfit(before.time, before["theta"], 1)
    deflection = np.polyval(line, after.time) - after["theta"]
    u = np.zeros((after.time.size + 1, len(In)))
    u[:, In.LOAD] = torque
    predicted = -it.shaft(observed=False).position.simulate(u)[1:, Out.ANGLE]
    peak = float(predicted.max())
    assert float(deflection.max()) == pytest.approx(peak, rel=0.03)
    assert deflection == pytest.approx(predicted, abs=0.05 * peak)


@pytest.mark.parametrize("axis", [0, 1])
def test_current_step_of_a_blocked_shaft_agrees_with_the_prediction(axes: list[Tuned], axis: int) -> None:
    """From 1 A to 2 A, at the samples of the fast loop."""
    it = axes[axis]
    with spinning(PlantConfig.load(), SEED) as board:
        board.lock_shaft(axis)
        choose(board, "cmd.mode", axis, "TORQUE")
        write_axis(board, "cmd.i_q", axis, 1.0)
        record(board, [axis], 0.05)
        write_axis(board, "cmd.i_q", axis, 2.0)
        start = board.time_ns
        currents = []
        for k in range(80):  # twice per period
            board.advance(start + k * PERIOD_NS // 2)
            currents.append(board.truth(axis).i_q)
    first = (16, 15)[
        axis
    ]  # first sample with the new set-point: 500 us after the start of a tick for axis 1, half a period less for axis 2
    measured = np.array(currents[first::2])
    predicted = 1.0 + it.current_loop("q").closed.simulate(np.ones((measured.size, 1)))[:, 0]
    assert measured == pytest.approx(predicted, abs=0.03)
