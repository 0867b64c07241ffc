"""The plant at switching level against an independent integration of the same edges of the gates."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pytest
from native_library import Native
from servo_twin.plant import PlantConfig
from switching_reference import HIGH, LOW, OPEN, Edge, Reference, centred_edges
from switching_rig import Switching

PERIOD = 6250
DEAD = 100

AMPERES = 2e-4
"""Bound on each phase current: a twentieth of a converter's step (4 mA)."""

ANY_AMPERES = 1e-3
"""The bound in linear intervals with random gates, shafts at up to 700 rad/s and currents of some amperes."""

ROUGHNESS = 10.0
"""Factor of the other bounds in that case: the largest deviations of 600 runs were 2.4e-3 rad/s and 1.2e-4 V."""


def plant() -> PlantConfig:
    return PlantConfig.load().with_axis(0, theta_start=0.3).with_axis(1, theta_start=-1.0)


def compare(
    switching: Switching,
    reference: Reference,
    edges: Sequence[Edge],
    until: int,
    step: int = 1000,
    *,
    amperes: float = AMPERES,
    roughness: float = 1.0,
) -> float:
    """Run both with the same edges and compare their states at each step; return the largest current.

    `roughness` multiplies all bounds except those of the currents.
    """
    largest = 0.0
    remaining = sorted(edges, key=lambda edge: edge[0])
    for clock in range(step, until + 1, step):
        now = [edge for edge in remaining if edge[0] <= clock]
        remaining = remaining[len(now) :]
        switching.run(now, clock)
        reference.run(now, clock)
        for index, machine in enumerate(reference.axes):
            truth = switching.truth(index)
            where = f"axis {index}, clock {clock}"
            assert list(truth.phase) == pytest.approx(machine.phases(), abs=amperes), where
            assert truth.omega == pytest.approx(machine.omega, abs=1e-3 * roughness), where
            assert truth.theta == pytest.approx(machine.theta, abs=3e-6 * roughness), where
            assert truth.torque == pytest.approx(machine.torque(), abs=1e-5 * roughness), where
            largest = max(largest, *map(abs, machine.phases()))
        assert switching.bus.u_dc == pytest.approx(reference.u, abs=2e-5 * roughness)
    return largest


def modulated(duty: Callable[[int, int], Sequence[float]], periods: int, dead: int = DEAD) -> list[Edge]:
    """Edges of some periods; axis 2 half a period behind."""
    edges: list[Edge] = []
    for period in range(periods):
        for axis in range(2):
            start = period * PERIOD + axis * PERIOD // 2
            edges += centred_edges(start, PERIOD, duty(period, axis), dead, axis)
    return edges


@pytest.mark.parametrize("seed", range(3))
def test_random_duties_give_the_currents_of_the_reference(switching_c: Native, seed: int) -> None:
    rnd = random.Random(seed)
    edges = modulated(lambda period, axis: [rnd.uniform(0.25, 0.75) for _ in range(3)], 10)
    reference = Reference(plant())
    assert compare(Switching(switching_c, plant()), reference, edges, 11 * PERIOD) > 0.1


@pytest.mark.parametrize("omega", [300.0, -150.0, 5.0])
def test_turning_shafts_with_small_currents(switching_c: Native, omega: float) -> None:
    """Currents reach zero in dead times and zero vectors, and stay at zero or change their sign."""
    switching, reference = Switching(switching_c, plant()), Reference(plant())
    for axis in range(2):
        switching.spin(axis, omega)
        reference.axes[axis].omega = omega
    rnd = random.Random(4)
    edges = modulated(lambda period, axis: [rnd.uniform(0.44, 0.56) for _ in range(3)], 8)
    compare(switching, reference, edges, 9 * PERIOD, step=500)


def test_braking_lifts_the_bus(switching_c: Native) -> None:
    """Six open switches at a speed whose back-EMF is above the bus, and windings shorted for a while."""
    switching, reference = Switching(switching_c, plant()), Reference(plant())
    for axis in range(2):
        switching.spin(axis, 600.0)
        reference.axes[axis].omega = 600.0
    short = [(clock, 0, phase, gates) for clock, gates in ((100, LOW), (3000, OPEN)) for phase in range(3)]
    pumped = [(clock, 1, 0, gates) for n in range(5) for clock, gates in ((n * 1800, LOW), (n * 1800 + 900, OPEN))]
    assert compare(switching, reference, [*short, *pumped], 12_000, step=400) > 1.0
    assert switching.bus.u_dc > 24.0


def test_a_shaft_that_stops_and_turns_back(switching_c: Native) -> None:
    switching, reference = Switching(switching_c, plant()), Reference(plant())
    for index, (axis, omega) in enumerate(zip(reference.axes, (0.04, -0.04), strict=True)):
        switching.spin(index, omega)
        axis.omega = omega
    edges = modulated(lambda period, axis: (0.35, 0.6, 0.55) if axis == 0 else (0.6, 0.4, 0.5), 6)
    compare(switching, reference, edges, 6 * PERIOD, step=500)
    assert reference.axes[1].omega > 0.1


def test_comparison_detects_a_wrong_dead_time(switching_c: Native) -> None:
    """The comparison can fail: it detects 20 ns more dead time."""
    switching, reference = Switching(switching_c, plant()), Reference(plant())
    duty = (0.65, 0.45, 0.4)
    switching.run(sorted(modulated(lambda *_: duty, 3), key=lambda edge: edge[0]), 3 * PERIOD)
    reference.run(sorted(modulated(lambda *_: duty, 3, DEAD + 2), key=lambda edge: edge[0]), 3 * PERIOD)
    assert abs(switching.truth(0).phase[0] - reference.axes[0].phases()[0]) > 10 * AMPERES


def test_every_gate_pattern_agrees_with_the_reference(switching_c: Native) -> None:
    """All 27 states of the legs in sequence; each starts with the currents of the previous one."""
    switching, reference = Switching(switching_c, plant()), Reference(plant())
    states = list(itertools.product((OPEN, HIGH, LOW), repeat=3))
    random.Random(7).shuffle(states)
    edges = [
        (137 + 251 * n, axis, phase, gates)
        for n, state in enumerate(states)
        for axis in range(2)
        for phase, gates in enumerate(state)
    ]
    assert compare(switching, reference, edges, 137 + 251 * 28, step=251) > 0.05


@dataclass(frozen=True)
class RandomRun:
    """Run with random angles and speeds of the shafts, and random states of the gates at random clocks."""

    config: PlantConfig  # plant data
    speeds: list[float]  # initial speeds of the shafts [rad/s]
    edges: list[Edge]  # edges of the gates


def random_run(seed: int, longest: int | None) -> RandomRun:
    """Random run with at most `longest` clocks between two edges; None: one of three values."""
    rnd = random.Random(seed)
    config = PlantConfig.load()
    for axis in range(2):
        config = config.with_axis(axis, theta_start=rnd.uniform(-3.0, 3.0))
    if longest is None:
        spans = [0.0, 10.0, 300.0, 700.0]
        speeds = [rnd.choice([rnd.uniform(-span, span) if span else 0.0 for span in spans]) for _ in range(2)]
        longest = rnd.choice([60, 300, 1500])
    else:
        speeds = [rnd.uniform(-700.0, 700.0) for _ in range(2)]
    edges: list[Edge] = []
    clock = 0
    while clock < 15_000:
        clock += rnd.randrange(60 if rnd.random() < 0.4 else longest) + 1
        edges.append((clock, rnd.randrange(2), rnd.randrange(3), rnd.randrange(3)))
    return RandomRun(config, speeds, edges)


# Shafts that overcome friction while a current grows (6, 8, 22, 47, 132), edges without apparent effect (6, 70), a
# current that crosses zero at the end of a step (78), legs that just begin to conduct (87 to 217), the largest
# deviations of linear intervals (221, 240, 276).
@pytest.mark.parametrize(
    ("seed", "longest"),
    [
        *((seed, None) for seed in (6, 8, 22, 47, 70, 78, 132, 221, 240)),
        *((seed, 2500) for seed in (87, 121, 201, 217, 276)),
    ],
)
@pytest.mark.parametrize("linear", [True, False])
def test_any_gates_give_the_currents_of_the_reference(
    request: pytest.FixtureRequest, linear: bool, seed: int, longest: int | None
) -> None:
    native = request.getfixturevalue("switching_c" if linear else "stepping_c")
    run = random_run(seed, longest)
    switching, reference = Switching(native, run.config), Reference(run.config)
    for axis, omega in enumerate(run.speeds):
        switching.spin(axis, omega)
        reference.axes[axis].omega = omega
    amperes = ANY_AMPERES if linear else AMPERES
    compare(switching, reference, run.edges, 16_000, step=250, amperes=amperes, roughness=ROUGHNESS)
