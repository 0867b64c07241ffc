"""Writing a parameter neither starts nor accelerates a shaft in any state, over the serial line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
import pytest
from line_simulation import LineSimulation
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import AXES, Catalogue, Variable
from servo_twin.level import Level

CATALOGUE: Final = Catalogue.load()
BAUD: Final = 115_200
MODES: Final = CATALOGUE.enums["control_mode_t"]
FEATURES: Final = {flag.name: flag.mask for flag in CATALOGUE.flags["features"]}
WATCHED: Final = 0.15
"""Observation time after each write [s]."""

HELD: Final = {"ideal": 3 * 2.0 * np.pi / 4000, "registers": 8 * 2.0 * np.pi / 4000}
"""Largest motion of a held shaft [rad]; it hunts by some more counts with the switching plant."""

EXPECTED: Final = {"FAULT", "STOP", "READY", "FREEWHEEL", "HOST_SILENT", "FOLLOWING_ERROR", "OVER_SPEED"}
"""States and faults in which a parameter may end a motion."""

FASTER: Final = 1.6
"""Largest increase of the speed of a turning shaft [rad/s]: its ripple."""

FASTER_SENSORLESS: Final = 4.0
"""Largest increase of the speed without an encoder [rad/s]."""


def values(variable: Variable) -> list[int]:
    """Raw numbers to write: both ends of the range, its middle, every enumerator, every single feature."""
    low, high = variable.to_raw(variable.minimum), variable.to_raw(variable.maximum)
    if variable.name == "param.monitor":
        return [high]
    if variable.enum is not None:
        return sorted(CATALOGUE.enums[variable.enum].values())
    if variable.flags == "features":
        return [0, high, *(15 ^ flag.mask for flag in CATALOGUE.flags["features"])]
    return sorted({low, (low + high) // 2, high})


def disabled(sim: LineSimulation) -> None:
    sim.host.write("cmd.enable", 0, 0)
    sim.run(0.3, sim.host.keep_alive)
    sim.run(1.3, sim.host.keep_alive)
    assert sim.states() == ["STOP"] * AXES


def holding(sim: LineSimulation) -> None:
    pass


def moving(sim: LineSimulation) -> None:
    """A position move that is longer than the test, below the speed of later set-points."""
    sim.host.write("param.speed_limit", 50.0, 50.0)
    sim.host.write("cmd.position", 1e4, -1e4)
    sim.run(0.5, sim.host.keep_alive)


def turning(sim: LineSimulation) -> None:
    """A speed set-point that is reduced by the limit."""
    sim.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    sim.host.write("cmd.speed", 200.0, -200.0)
    sim.run(0.3, sim.host.keep_alive)
    sim.host.write("param.speed_limit", 50.0, 50.0)
    sim.run(0.5, sim.host.keep_alive)


def held_at_a_soft_limit(sim: LineSimulation) -> None:
    """Speed set-points that soft limits have reduced to 0."""
    sim.host.write("param.position_max", 5.0, 5.0)
    sim.host.write("param.position_min", -5.0, -5.0)
    sim.host.write_raw("param.features", *[FEATURES["POSITION_LIMITS"] | 15] * AXES)
    sim.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    sim.host.write("cmd.speed", 50.0, -50.0)
    sim.run(2.0, sim.host.keep_alive)


def pushing(sim: LineSimulation) -> None:
    """Torque set-points that are limited by a reduced speed limit."""
    sim.host.write("cmd.mode", *[MODES["TORQUE"]] * AXES)
    sim.host.write("param.speed_limit", 50.0, 50.0)
    sim.host.write("cmd.i_q", 3.0, -3.0)
    sim.run(0.1, sim.host.keep_alive)
    sim.host.write("param.i_q_limit", 0.5, 0.5)
    sim.run(0.7, sim.host.keep_alive)


def expired(sim: LineSimulation) -> None:
    sim.host.write("param.command_timeout", 0.1)
    sim.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    sim.host.write("cmd.speed", 50.0, -50.0)
    sim.run(0.5, sim.host.keep_alive)


def stopped(sim: LineSimulation) -> None:
    """A quick stop from motion."""
    turning(sim)
    sim.host.command("QUICK_STOP")
    sim.run(0.5, sim.host.keep_alive)


def in_fault(sim: LineSimulation) -> None:
    turning(sim)
    sim.host.write_raw("param.features", *[FEATURES["OVER_SPEED"] | 15] * AXES)
    sim.host.write("param.over_speed", 10.0, 10.0)
    sim.run(4.0, sim.host.keep_alive)
    assert sim.states() == ["FAULT OVER_SPEED"] * AXES


def sensorless_ready(sim: LineSimulation) -> None:
    """Without an encoder, with a speed set-point that is limited below the minimum speed."""
    disabled(sim)
    sim.host.write("param.feedback", *[CATALOGUE.enums["feedback_kind_t"]["OBSERVER"]] * AXES)
    sim.host.write("param.speed_limit", 1.0, 1.0)
    sim.host.write("cmd.mode", *[MODES["SPEED"]] * AXES)
    sim.host.write("cmd.enable", 1, 1)
    sim.run(1.0, sim.host.keep_alive)
    sim.host.write("cmd.speed", 100.0, -100.0)
    sim.run(0.5, sim.host.keep_alive)
    assert sim.states() == ["READY"] * AXES


def sensorless_turning(sim: LineSimulation) -> None:
    sensorless_ready(sim)
    sim.host.write("param.speed_limit", 100.0, 100.0)
    sim.host.write("cmd.speed", 200.0, -200.0)
    sim.run(3.0, sim.host.keep_alive)
    assert sim.states() == ["SPIN"] * AXES


STATES: Final = (
    disabled, holding, moving, turning, held_at_a_soft_limit, pushing, expired, stopped, in_fault, sensorless_ready,
    sensorless_turning,
)  # fmt: skip


AT_BOTH_LEVELS: Final = (holding, turning, held_at_a_soft_limit, pushing, sensorless_turning)
"""States of turning or held shafts, on which the ripple of the switching plant acts."""

CASES: Final = [*(("ideal", reach) for reach in STATES), *(("registers", reach) for reach in AT_BOTH_LEVELS)]


@pytest.fixture
def new_simulation() -> Iterator[Callable[[Level], LineSimulation]]:
    """Creates boards with both axes in SPIN and set-points that do not expire."""
    made: list[LineSimulation] = []

    def fresh(level: Level) -> LineSimulation:
        for sim in made:
            sim.close()
        made[:] = [LineSimulation(level, BAUD)]
        sim = made[0]
        sim.host.write("param.command_timeout", 0.0)
        sim.host.write("param.host_timeout", 5.0)
        sim.enable()
        return sim

    yield fresh
    for sim in made:
        sim.close()


@pytest.mark.parametrize(("level", "reach"), CASES, ids=lambda value: getattr(value, "__name__", value))
def test_parameter_written(
    new_simulation: Callable[[Level], LineSimulation], level: Level, reach: Callable[[LineSimulation], None]
) -> None:
    faster = FASTER_SENSORLESS if reach is sensorless_turning else FASTER
    sim: LineSimulation | None = None
    for variable in parameters(CATALOGUE):
        for raw in values(variable):
            if sim is None:
                sim = new_simulation(level)
                reach(sim)
                before, states = {v.name: sim.board.read_words(v.name) for v in parameters(CATALOGUE)}, sim.states()
            sim.host.keep_alive()
            start = sim.now
            was = np.abs(sim.line.log.omega[-100:]).mean(axis=0)
            sim.host.write_raw(variable.name, *[raw] * variable.count)
            sim.run(WATCHED)
            sim.host.write_raw(variable.name, *before[variable.name])
            sim.run(WATCHED)
            _, omega = sim.since(start, sim.line.log.omega)
            what = f"{variable.name} = {raw}"
            gain = float((np.abs(omega).max(axis=0) - was).max())
            if was.max() < 1.0:
                assert sim.travel(start) <= HELD[sim.board.level], what
            else:
                assert gain <= faster, f"{what}: faster by {gain:.1f} rad/s"
            stopped_by = set(" ".join(sim.states()).split()) - set(" ".join(states).split())
            assert stopped_by <= EXPECTED, what
            if sim.states() != states or (was.max() > 1.0 and np.abs(omega[-1]).max() < 0.97 * was.max()):
                sim = None  # a fault or a lower limit has stopped the motion
