"""Estimators of a motor test with synthetic recordings of known motors."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_measurement.access import MeasurementError
from servo_measurement.least_squares import fit_linear, fit_nonlinear, mean_of
from servo_measurement.log import Call, MeasurementLog, repeat
from servo_measurement.motor_values import Estimate, Limits
from servo_measurement.rotating_vector import follow_vector
from servo_measurement.speed_runs import balance
from servo_measurement.standstill import impedance, ohmic, switching_share
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD

Floats = NDArray[np.float64]

NAMES = ("i", "u", "d")


def _sweep(r: float, inductance: float, seed: int, *, noise: float = 0.008) -> Trace:
    """PI-controlled winding with a swept set-point; the voltage is loaded half a period after its sample."""
    rng = np.random.default_rng(seed)
    size, calls, omega = 1280, 1100, 2.0 * math.pi * 400.0
    kp, ki = omega * inductance, omega * r * PERIOD
    d = np.zeros(size)
    phase, step = 0.0, 150.0 * PERIOD
    for k in range(calls):
        d[k] = math.sin(2.0 * math.pi * phase)
        phase, step = phase + step, step * (1.0 + math.log(20.0) / calls)
    half = math.exp(-0.5 * r * PERIOD / inductance)
    current, integral, applied = 1.0, r * 1.0, r * 1.0
    i, u = np.zeros(size), np.zeros(size)
    for k in range(size):
        i[k] = current + noise * rng.standard_normal()
        error = 1.0 + d[k] - i[k]
        integral += ki * error
        u[k] = kp * error + integral
        for voltage in (applied, u[k]):
            current = half * current + (1.0 - half) / r * voltage
        applied = u[k]
    return Trace(PERIOD, {"i": i, "u": u, "d": d})


@pytest.mark.parametrize(("r", "inductance"), [(0.2, 0.1e-3), (0.6, 0.5e-3), (6.0, 3e-3)])
def test_inductance_and_delay_are_estimated_from_a_swept_sine(r: float, inductance: float) -> None:
    found = impedance([_sweep(r, inductance, seed) for seed in range(3)], NAMES, r, (400.0, 2500.0))
    assert found.inductance.value == pytest.approx(inductance, rel=0.01)
    assert found.delay.value == pytest.approx(0.5 * PERIOD, abs=0.05 * PERIOD)
    assert found.inductance.part < 0.02


def test_missing_samples_are_taken_from_the_repetitions() -> None:
    rng = np.random.default_rng(1)

    def gaps(whole: Trace) -> Trace:
        return whole.changed(
            **{name: np.where(rng.random(len(whole)) < 0.1, np.nan, values) for name, values in whole.columns.items()}
        )

    recordings = [gaps(_sweep(0.6, 0.5e-3, seed)) for seed in range(3)]
    found = impedance(recordings, NAMES, 0.6, (400.0, 2500.0))
    assert found.inductance.value == pytest.approx(0.5e-3, rel=0.02)


def test_no_sample_of_a_signal_is_an_error() -> None:
    whole = _sweep(0.6, 0.5e-3, 0)
    recording = whole.changed(i=np.full(len(whole), np.nan))
    with pytest.raises(MeasurementError, match="missing"):
        impedance([recording], NAMES, 0.6, (400.0, 2500.0))


def test_resistance_is_separated_from_the_inverter_voltage_drop() -> None:
    current = np.linspace(0.8, 4.0, 9)
    lost = (2.0 / 3.0) * 1.08 * (switching_share(current / 0.1) + switching_share(0.5 * current / 0.1))
    noise = 1e-3 * np.random.default_rng(1).standard_normal(9)
    found = ohmic(current, 0.58 * current + lost + noise, np.full(9, 1e-3))
    assert found.resistance.value == pytest.approx(0.58, rel=0.01)
    assert found.lost.value == pytest.approx(1.08, rel=0.01)
    low, high = found.resistance.interval
    assert low < 0.58 < high


@pytest.mark.parametrize("pairs", [1, 2, 7])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_pole_pairs_and_direction_are_estimated(pairs: int, direction: float) -> None:
    theta = np.linspace(0.0, 9.0, 400)
    wrapped = np.angle(np.exp(1j * theta))
    position = direction * theta / pairs
    position[50:60] = np.nan
    found = follow_vector(position, wrapped)
    assert (found.pole_pairs, found.direction) == (pairs, direction)


@pytest.mark.parametrize("position", [np.zeros(400), np.linspace(0.0, 9.0 / 2.4, 400)])
def test_no_pole_pairs_from_a_shaft_that_does_not_follow(position: Floats) -> None:
    with pytest.raises(MeasurementError):
        follow_vector(position, np.angle(np.exp(1j * np.linspace(0.0, 9.0, 400))))


def test_inertia_is_estimated_from_the_momentum() -> None:
    step, inertia, coulomb, pairs, psi = 1e-3, 2e-5, 2e-3, 2, 0.015
    time = step * np.arange(600)
    speed = 50.0 * np.sin(2.0 * math.pi * 2.0 * time)
    torque = inertia * np.gradient(speed, step) + coulomb * np.sign(speed)
    columns = {"a.position": np.cumsum(speed) * step, "a.i_q": torque / (1.5 * pairs * psi), "a.i_d": np.zeros(600)}
    found, dry = balance([Trace(step, columns)], "a", (pairs, psi, 1e-3, 1e-3), None)
    assert found.value == pytest.approx(inertia, rel=0.01)
    assert dry.value == pytest.approx(coulomb, rel=0.05)


def test_uncertainty_of_a_linear_fit_agrees_with_its_errors() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 50)
    inside = 0
    for _ in range(200):
        y = 2.0 + 3.0 * x + 0.1 * rng.standard_normal(50)
        line, covariance, _ = fit_linear(np.column_stack([np.ones(50), x]), y)
        inside += abs(line[1] - 3.0) < 1.96 * math.sqrt(covariance[1, 1])
    assert 180 <= inside <= 199
    curve, _ = fit_nonlinear(lambda p: p[0] * np.exp(-p[1] * x) - 2.0 * np.exp(-3.0 * x), np.ones(2), np.ones(2))
    assert curve == pytest.approx([2.0, 3.0], rel=1e-4)
    assert mean_of(np.array([1.0, np.nan]))[1] == math.inf


def test_log_is_restored_from_its_file(tmp_path: Path) -> None:
    inner = (Call("write", ("cmd.speed", [5], 0)),)
    calls = [
        Call("write", ("cmd.i_q", [100], 1)),
        Call("wait", (0.5,), stage="turn"),
        Call("record", (["axis2.i_d", "axis2.u_d"], 3, 2, True, None), inner, "speed"),
    ]
    columns = {"axis2.i_d": np.array([1.0, np.nan, 3.0]), "axis2.u_d": np.zeros(3)}
    log = MeasurementLog(1, calls, [Trace(1e-3, columns)], {"limits": asdict(Limits(24.0, 4.0))})
    log.save(tmp_path / "log.npz")
    found = MeasurementLog.load(tmp_path / "log.npz")
    assert [one.kind for one in found.calls] == ["write", "wait", "record"]
    assert found.calls[2].inner[0].arguments[0] == "cmd.speed"
    assert (found.axis, found.notes, found.labels) == (1, log.notes, ["speed"])
    assert found.seconds == pytest.approx(0.5 + 3 * 2 * 0.5e-3)
    np.testing.assert_array_equal(found.labelled("speed")[0]["axis2.i_d"], columns["axis2.i_d"])


def test_other_files_are_refused_as_log(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(MeasurementError, match=r"other\.npz"):
        MeasurementLog.load(tmp_path / "other.npz")


def test_stages_may_be_omitted_in_a_repetition() -> None:
    recording = Trace(1e-3, {"a": np.zeros(3)})
    record = Call("record", (["a"], 3, 1, True, None), (), "turn_slow", "turn")
    log = MeasurementLog(0, [record], [recording])
    assert repeat(log, None, ("turn",)) == [recording]  # type: ignore[arg-type]


@pytest.mark.parametrize("values", [{"voltage": 0.0}, {"current": -1.0}, {"speed": math.nan}, {"r_on": -1.0}])
def test_invalid_limits_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(values))):
        Limits(**{"voltage": 24.0, "current": 4.0, **values})


def test_interval_of_an_estimate_has_95_percent() -> None:
    assert Estimate(2.0, 0.5).interval == pytest.approx((1.02, 2.98))
    assert Estimate(0.0, 0.5).part == math.inf
