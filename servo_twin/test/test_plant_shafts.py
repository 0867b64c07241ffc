"""Real shafts, magnets and encoder discs, at both levels, against closed forms and an integration in fine steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.board_port import choose, write_axis
from servo_twin.board import Board
from servo_twin.level import Level
from servo_twin.plant import PlantConfig, PlantError
from servo_twin.simulation import enable
from servo_twin.truth import Truth

LEVELS: list[Level] = ["ideal", "registers"]
PERIOD = 62_500  # [ns]
COPPER = 3.93e-3  # [1/K]

pytestmark = pytest.mark.parametrize("level", LEVELS)


def free(**axis: Any) -> PlantConfig:
    """Axis 1 without friction, its rotor at a known angle."""
    return PlantConfig.load().with_axis(0, **{"friction": 0.0, "viscous": 0.0, "theta_start": 0.3, **axis})


def watch(board: Board, periods: int) -> tuple[NDArray[np.float64], list[Truth]]:
    """Time since the start [s] and truth of axis 1, at the end of each PWM period."""
    truths = []
    for _ in range(periods):
        board.advance(board.time_ns + PERIOD)
        truths.append(board.truth(0))
    return np.arange(1, periods + 1, dtype=np.float64) * (PERIOD * 1e-9), truths


def values(truths: list[Truth], name: str) -> NDArray[np.float64]:
    return np.array([getattr(truth, name) for truth in truths])


def fit_sine(time: NDArray[np.float64], signal: NDArray[np.float64], near: float) -> tuple[float, float, float]:
    """Frequency [Hz], amplitude and mean of a sine by least squares; `near` is an estimate of the frequency [Hz]."""
    best = (math.inf, near, 0.0, 0.0)
    span = 0.03 * near
    for _ in range(7):
        for f in np.linspace(best[1] - span, best[1] + span, 41):
            x = 2.0 * np.pi * f * time
            matrix = np.stack([np.sin(x), np.cos(x), np.ones_like(x)], axis=1)
            c, *_ = np.linalg.lstsq(matrix, signal, rcond=None)
            best = min(best, (float(np.std(signal - matrix @ c)), f, math.hypot(c[0], c[1]), float(c[2])))
        span *= 0.1
    return best[1], best[2], best[3]


# ---- two masses ------------------------------------------------------------------------------------------------------


def stiffness(frequency: float, *inertias: float) -> float:
    """Stiffness of a spring with which the masses oscillate at `frequency` [Hz]."""
    return (2.0 * math.pi * frequency) ** 2 / sum(1.0 / inertia for inertia in inertias)


@pytest.mark.parametrize("frequency", [80.0, 1000.0])
def test_resonance_of_two_masses(level: Level, frequency: float) -> None:
    rotor, load, torque = 0.8e-5, 2.0e-5, 0.01
    k = stiffness(frequency, rotor, load)
    with Board(free(load_inertia=load, shaft_stiffness=k), level=level) as board:
        board.run(0.01)
        board.set_load(0, torque)
        time, truths = watch(board, 800)
    twist = values(truths, "theta_m") - values(truths, "theta_load")
    seen, amplitude, mean = fit_sine(time, twist, frequency)
    expected = torque / load / (2.0 * math.pi * frequency) ** 2
    step = 7.9e-6
    assert seen == pytest.approx(frequency, rel=1e-6 + (2.0 * math.pi * frequency * step) ** 2 / 20.0)
    assert amplitude == pytest.approx(expected, rel=2e-3)
    assert mean == pytest.approx(expected, rel=2e-3)
    together = (rotor * values(truths, "omega_m") + load * values(truths, "omega_load")) / (rotor + load)
    assert np.polyfit(time, together, 1)[0] == pytest.approx(-torque / (rotor + load), rel=1e-4)


@pytest.mark.parametrize("frequency", [60.0, 600.0])
def test_antiresonance_with_the_rotor_held(level: Level, frequency: float) -> None:
    load = 1.5e-5
    with Board(free(load_inertia=load, shaft_stiffness=stiffness(frequency, load)), level=level) as board:
        board.lock_shaft(0)
        board.set_load(0, 0.01)
        time, truths = watch(board, 800)
    seen, _, _ = fit_sine(time, values(truths, "theta_load"), frequency)
    assert seen == pytest.approx(frequency, rel=5e-4)
    assert np.ptp(values(truths, "theta_m")) == 0.0


def test_damping_of_the_shaft(level: Level) -> None:
    """The twist decays with d / (2 mu), mu the reduced mass."""
    rotor, load, frequency, ratio = 0.8e-5, 0.8e-5, 300.0, 0.02
    mu = 1.0 / (1.0 / rotor + 1.0 / load)
    d = 2.0 * ratio * mu * 2.0 * math.pi * frequency
    config = free(load_inertia=load, shaft_stiffness=stiffness(frequency, rotor, load), shaft_damping=d)
    with Board(config, level=level) as board:
        board.set_load(0, 0.01)
        board.run(0.2)
        board.set_load(0, 0.0)
        _, truths = watch(board, 640)
    twist = values(truths, "theta_m") - values(truths, "theta_load")
    # the first and the last twelve periods of the oscillation
    early, late = (np.max(np.abs(part)) for part in (twist[:160], twist[-160:]))
    assert math.log(early / late) == pytest.approx(480 * PERIOD * 1e-9 * d / (2.0 * mu), rel=0.03)


def test_energy_is_conserved_with_backlash(level: Level) -> None:
    """Elastic impacts of rotor and mass conserve energy and momentum."""
    rotor, load, gap, k = 0.8e-5, 1.2e-5, 0.02, 20.0
    config = free(load_inertia=load, shaft_stiffness=k, backlash=gap)
    with Board(config, level=level) as board:
        board.set_load(0, -0.02)
        board.run(0.02)
        board.set_load(0, 0.0)
        _, truths = watch(board, 3200)
    omega_m, omega_load = values(truths, "omega_m"), values(truths, "omega_load")
    twist = values(truths, "theta_m") - values(truths, "theta_load")
    deep = np.maximum(np.abs(twist) - 0.5 * gap, 0.0)
    energy = 0.5 * rotor * omega_m**2 + 0.5 * load * omega_load**2 + 0.5 * k * deep**2
    momentum = rotor * omega_m + load * omega_load
    assert np.sum(np.diff(np.sign(twist)) != 0) > 10, "the gap is crossed in both directions"
    assert np.ptp(momentum) < 1e-6 * abs(momentum[0])
    together = 0.5 * momentum[0] ** 2 / (rotor + load)  # of the common motion, which contacts do not change
    assert np.ptp(energy) < 0.02 * (energy.mean() - together)


def test_backlash_is_the_distance_between_the_flanks(level: Level) -> None:
    """With the rotor locked and the mass pushed to either side: rest positions differ by gap + 2 torque / k."""
    gap, k, torque = 0.01, 5.0, 0.02
    config = free(load_inertia=1e-5, shaft_stiffness=k, shaft_damping=0.01, backlash=gap)
    rest = []
    with Board(config, level=level) as board:
        board.lock_shaft(0)
        for sign in (1.0, -1.0):
            board.set_load(0, sign * torque)
            board.run(0.3)
            rest.append(board.truth(0).theta_load)
            assert board.truth(0).torque_shaft == pytest.approx(sign * torque, rel=1e-6)
    assert rest[1] - rest[0] == pytest.approx(gap + 2.0 * torque / k, rel=1e-6)


def test_friction_holds_the_load_within_the_gap(level: Level) -> None:
    """A torque below the load friction does not move the mass within the gap."""
    config = free(load_inertia=1e-5, shaft_stiffness=50.0, backlash=0.05, load_friction=5e-3)
    with Board(config, level=level) as board:
        start = board.truth(0).theta_load
        board.set_load(0, 4.9e-3)
        board.run(0.05)
        assert board.truth(0).theta_load == start
        board.set_load(0, 6e-3)
        board.run(0.01)
        assert board.truth(0).theta_load == pytest.approx(start - 0.5 * 1e-3 / 1e-5 * 0.01**2, rel=2e-3)


def test_two_masses_against_an_integration_in_fine_steps(level: Level) -> None:
    """Rotor friction, load friction, damping, backlash and a load step at once."""
    rotor, load, k, d, gap, torque = 0.8e-5, 1.2e-5, 40.0, 1e-3, 0.004, 0.03
    friction, load_friction, viscous = 2e-3, 3e-3, 1e-5
    config = free(
        friction=friction, viscous=viscous, load_inertia=load, shaft_stiffness=k, shaft_damping=d, backlash=gap,
        load_friction=load_friction,
    )  # fmt: skip
    with Board(config, level=level) as board:
        board.run(0.005)
        board.set_load(0, -torque)
        _, truths = watch(board, 320)
    x = np.array([0.0, 0.0, 0.0, 0.0])  # theta, omega of rotor and mass
    h = 2.5e-7
    seen = []
    for n in range(round(320 * PERIOD * 1e-9 / h)):
        twist, speed = x[0] - x[2], x[1] - x[3]
        deep = math.copysign(max(abs(twist) - 0.5 * gap, 0.0), twist)
        push = k * deep + d * speed
        push = push if push * deep > 0.0 else 0.0
        for place, free_torque, inertia, maximum, b in (
            (1, -push, rotor, friction, viscous),
            (3, push + torque, load, load_friction, 0.0),
        ):
            omega = x[place] + h * (free_torque - b * x[place]) / inertia
            brake = h * maximum / inertia
            x[place] = math.copysign(max(abs(omega) - brake, 0.0), omega)
        x[0] += h * x[1]
        x[2] += h * x[3]
        if (n + 1) % 250 == 0:
            seen.append(x.copy())
    for place, name, off in ((1, "omega_m", 0.3), (3, "omega_load", 0.3)):
        reference = np.array(seen)[:, place]
        assert np.max(np.abs(values(truths, name) - reference)) < off, name
        assert np.ptp(reference) > 20.0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"load_inertia": 1e-5}, "shaft_stiffness: must be above 0"),
        ({"load_inertia": 1e-5, "shaft_stiffness": 1e6}, "gives a resonance of"),
        ({"disc_eccentricity": 0.5}, "disc_eccentricity: 0.5 is too large; write a number from 0 up to 0.2"),
        ({"backlash": -1.0}, "backlash: -1.0 is too small"),
    ],
)
def test_invalid_shaft_is_refused(level: Level, changes: dict[str, float], text: str) -> None:
    with pytest.raises(PlantError, match=text):
        free(**changes)


# ---- cogging ---------------------------------------------------------------------------------------------------------


def test_cogging_oscillation_and_holding_angle(level: Level) -> None:
    """Oscillation about a stable angle with sqrt(A N / J); with viscous friction the rotor rests where sin = T / A."""
    torque, periods, phase, inertia = 5e-3, 24.0, 0.4, 0.8e-5
    rest = (math.pi - phase) / periods  # the sine decreases there
    config = free(cogging_torque=torque, cogging_periods=periods, cogging_phase=phase, theta_start=rest + 1e-3)
    with Board(config, level=level) as board:
        time, truths = watch(board, 800)
    frequency = math.sqrt(torque * periods / inertia) / (2.0 * math.pi)
    seen, amplitude, mean = fit_sine(time, values(truths, "theta_m"), frequency)
    assert seen == pytest.approx(frequency, rel=1e-3)
    assert amplitude == pytest.approx(1e-3, rel=1e-2)
    assert mean == pytest.approx(rest, abs=1e-6)
    with Board(config.with_axis(0, viscous=1e-3), level=level) as board:
        for load in (0.0, 3e-3, -4e-3):
            board.set_load(0, load)
            board.run(0.6)
            angle = rest - math.asin(load / torque) / periods
            assert board.truth(0).theta_m == pytest.approx(angle, abs=1e-7)


def test_cogging_holds_up_to_its_torque(level: Level) -> None:
    config = free(cogging_torque=5e-3, cogging_periods=24.0, viscous=4e-3, theta_start=math.pi / 24.0)
    with Board(config, level=level) as board:
        board.set_load(0, -4.9e-3)
        board.run(3.0)
        assert abs(board.truth(0).omega_m) < 1e-6
        board.set_load(0, -6e-3)
        board.run(0.3)
        assert board.truth(0).omega_m > 0.01
        assert board.truth(0).theta_m > math.pi / 24.0 + 0.1


# ---- disc ------------------------------------------------------------------------------------------------------------


def test_eccentric_disc_shows_an_error_once_per_turn(level: Level) -> None:
    a, phase = 0.01, 0.9
    config = free(disc_eccentricity=a, disc_phase=phase)
    lines = config.axes[0].encoder_lines
    with Board(config, level=level) as board:
        board.set_load(0, -0.01)
        board.run(0.08)
        board.set_load(0, 0.0)
        rows = []
        for _ in range(120):
            log = board.record(board.time_ns + 1_000_000)
            rows.append((board.truth(0).theta_m, int(log["axis1.position"][-1]), board.si(log)["axis1.speed"][-1]))
        omega = board.truth(0).omega_m
    theta, position, speed = np.array(rows).T
    error = position * 2.0 * np.pi / (4.0 * lines) - theta
    matrix = np.stack([np.sin(theta), np.cos(theta), np.ones_like(theta)], axis=1)
    (s, c, _), *_ = np.linalg.lstsq(matrix, error, rcond=None)
    late = omega * 1e-3  # a snapshot may be one tick old
    assert math.hypot(s, c) == pytest.approx(a, rel=0.02)
    assert math.atan2(c, s) == pytest.approx(phase, abs=1.5 * late)
    (s, c, mean), *_ = np.linalg.lstsq(matrix, speed, rcond=None)
    assert mean == pytest.approx(omega, rel=2e-3)
    assert math.hypot(s, c) == pytest.approx(a * omega, rel=0.1)


def test_edges_of_an_eccentric_disc_keep_their_order(level: Level) -> None:
    """One revolution in each direction with the largest permitted eccentricity: no count is lost."""
    with Board(free(disc_eccentricity=0.19, viscous=1e-5), level=level) as board:
        board.run(0.01)
        start = board.read_words("axis1.position")[0], board.truth(0).theta_m
        for load in (-0.01, 0.01, 0.01, -0.01):
            board.set_load(0, load)
            board.run(0.05)
        board.lock_shaft(0)
        board.run(0.01)
        end = board.read_words("axis1.position")[0], board.truth(0).theta_m
    seen_angle = [theta + 0.19 * math.sin(theta) for _, theta in (start, end)]
    assert end[0] - start[0] == pytest.approx((seen_angle[1] - seen_angle[0]) * 4000.0 / (2.0 * math.pi), abs=1.5)


# ---- winding, iron, magnet -------------------------------------------------------------------------------------------


def root(current: float, scale: float) -> float:
    """Flux over L i_s of a current, from x + x^3 / 3 = i / i_s."""
    x = np.roots([1.0 / 3.0, 0.0, 1.0, -current / scale])
    return float(x[np.abs(x.imag) < 1e-9].real[0])


@pytest.mark.parametrize("current", [1.0, 3.0, -4.0])
def test_inductance_falls_with_the_current(level: Level, current: float) -> None:
    """A locked rotor with a current: differential inductances and torque, by the root of the saturation law."""
    i_s = 3.0
    config = PlantConfig.load().with_axis(0, i_saturation_q=i_s, i_saturation_d=2.0 * i_s)
    with Board(config, level=level, seed=2) as board:
        enable(board)
        board.lock_shaft(0)
        choose(board, "cmd.mode", 0, "TORQUE")
        write_axis(board, "cmd.i_q", 0, current)
        board.run(0.01)
        truth = board.truth(0)
    axis = config.axes[0]
    assert truth.i_q == pytest.approx(current, abs=0.3)
    x_d, x_q = root(truth.i_d, 2.0 * i_s), root(truth.i_q, i_s)
    assert truth.l_q == pytest.approx(axis.l_q / (1.0 + x_q**2), rel=1e-3)
    assert truth.l_d == pytest.approx(axis.l_d / (1.0 + x_d**2), rel=1e-3)
    psi_d, psi_q = axis.psi_m + axis.l_d * 2.0 * i_s * x_d, axis.l_q * i_s * x_q
    torque = 1.5 * axis.pole_pairs * (psi_d * truth.i_q - psi_q * truth.i_d)
    assert truth.torque_e == pytest.approx(torque, rel=1e-6)


def test_a_warm_winding_and_magnet_change_the_motor(level: Level) -> None:
    config = PlantConfig.load().with_axis(0, winding_warms=1.0, magnet_coefficient=-0.002, magnet_time=0.05)
    axis = config.axes[0]
    with Board(config, level=level) as board:
        board.run(0.01)
        truth = board.truth(0)
        assert (truth.r_s, truth.psi_m, truth.t_magnet) == pytest.approx((axis.r_s, axis.psi_m, 25.0), rel=1e-9)
        board.set_winding(0, 105.0)
        board.run(0.05)
        truth = board.truth(0)
        assert truth.t_magnet == pytest.approx(105.0 - 80.0 * math.exp(-1.0), abs=1.5)
        assert truth.r_s == pytest.approx(axis.r_s * (1.0 + COPPER * (truth.t_winding - 25.0)), rel=1e-5)
        assert truth.psi_m == pytest.approx(axis.psi_m * (1.0 - 0.002 * (truth.t_magnet - 25.0)), rel=1e-5)
        board.set_magnet(0, 150.0)
        board.run(0.002)
        assert board.truth(0).psi_m == pytest.approx(axis.psi_m * 0.76, rel=0.02)


def test_warm_magnet_lowers_the_voltage(level: Level) -> None:
    """Voltage at a given speed: R i plus the back-EMF, which is 15 % lower at 100 deg C."""
    axis = PlantConfig.load().axes[0]
    speed = 150.0
    seen = []
    for celsius in (25.0, 100.0):
        config = PlantConfig.load().with_axis(0, magnet_coefficient=-0.002, magnet_time=1e4)
        with Board(config, level=level) as board:
            board.set_magnet(0, celsius)
            enable(board)
            choose(board, "cmd.mode", 0, "SPEED")
            write_axis(board, "cmd.speed", 0, speed)
            board.set_load(0, 0.02)
            board.run(0.3)
            log = board.si(board.record(board.time_ns + 100_000_000))
            seen.append(float(np.mean(log["axis1.u_q"] - axis.r_s * log["axis1.i_q"])))
    assert seen[0] - seen[1] == pytest.approx(0.15 * axis.psi_m * axis.pole_pairs * speed, rel=0.05)
