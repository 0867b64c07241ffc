"""F21 and F22: a sine that asks for more current than the limit allows, with and without anti-windup."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import inertia_ratio
from servo_twin.experiments.rig import (
    RPM,
    TICK,
    Recording,
    choose_mode,
    command_speed,
    features,
    set_axis,
    spinning,
    watch,
)
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "anti-windup"
HELP: Final = """\
Speed control of axis 1, no load, sine of 500 rpm at 20 Hz, i_q limited to 1 A, same Kp and Ki in both runs. On a plant
with another inertia than the controller is tuned for, frequency and limit go with it: the loop is as much slower.
The reference design shows: with anti-windup (F21) almost no overshoot and a small lag;
without (F22) the limit is left only after the error has changed its sign: overshoot and lag at every peak."""

AXIS: Final = 0
AMPLITUDE: Final = 500.0 * RPM
FREQUENCY: Final = 20.0
WARM_UP: Final = 10  # periods
MEASURED: Final = 10  # periods

DEPTH: Final = 0.88
"""What the limited current can accelerate, over what the sine asks for. 1 A does this to the shaft of F21."""

CURRENT_MOST: Final = 4.0  # limit of the drive [A]

HIGHER_LEAST: Final = 1.1
"""Peak without anti-windup over the peak with it."""

LATER_LEAST: Final = 1.25
"""Lag without over the lag with it; friction takes some of the windup away."""


@dataclass(frozen=True)
class Response:
    """What a sine run gave.

    Attributes
    ----------
    peak : float
        Largest speed feedback, the mean over the half periods [rad/s].
    lag : float
        Of the peaks of the speed feedback behind those of the set-point, the mean [degrees].
    saturated : float
        Part of the time with the current set-point at its limit.
    recording : Recording
        The last periods.
    frequency : float
        Of the sine [Hz].
    """

    peak: float
    lag: float
    saturated: float
    recording: Recording
    frequency: float


def whole_ticks(frequency: float) -> float:
    """The nearest frequency whose quarter period is a whole number of slow ticks [Hz]."""
    return 0.25 / (TICK * max(round(0.25 / (TICK * frequency)), 1))


def current_limit(axis: AxisPlant, frequency: float) -> float:
    """Limit that saturates a shaft as deeply as 1 A does the one of F21 [A], in steps of 0.01 A."""
    torque = DEPTH * axis.inertia * AMPLITUDE * 2.0 * np.pi * frequency
    return float(np.clip(round(torque / axis.torque_constant, 2), 0.1, CURRENT_MOST))


def top_frequency(axis: AxisPlant) -> float:
    """Highest frequency for which the drive has the current that saturates a shaft so [Hz]."""
    return CURRENT_MOST * axis.torque_constant / (DEPTH * axis.inertia * AMPLITUDE * 2.0 * np.pi)


def sine(time: float, frequency: float) -> float:
    """Speed set-point at a time since the beginning [rad/s]."""
    return float(AMPLITUDE * np.sin(2.0 * np.pi * frequency * time))


def respond(plant: PlantConfig, seed: int, frequency: float, anti_windup: bool) -> Response:
    """Run the sine once."""
    limit = current_limit(plant.axes[AXIS], frequency)
    warm_up, measured = WARM_UP / frequency, MEASURED / frequency
    with spinning(plant, seed) as board:
        features(board, AXIS, ANTI_WINDUP=anti_windup)
        set_axis(board, "param.i_q_limit", AXIS, limit)
        set_axis(board, "param.acceleration_limit", AXIS, board.catalogue["param.acceleration_limit"].maximum)
        choose_mode(board, AXIS, "SPEED")

        def act(k: int) -> None:
            command_speed(board, AXIS, sine(k * TICK, frequency))

        whole = watch(board, [AXIS], warm_up + measured, act)[AXIS]
        lsb = board.catalogue["param.i_q_limit"].lsb
    part = whole.part(warm_up)
    peaks, lags = half_waves(part.speed, frequency)
    saturated = float(np.mean(np.abs(part.i_q_ref) >= limit - 2.0 * lsb))
    return Response(float(np.mean(peaks)), float(np.mean(lags)), saturated, part, frequency)


def half_waves(speed: NDArray[np.float64], frequency: float) -> tuple[list[float], list[float]]:
    """Height [rad/s] and lag [degrees] of every peak; the set-point's sine begins with the signal.

    Each is looked for in the half period that follows the peak of the set-point.
    """
    half = round(0.5 / frequency / TICK)
    peaks: list[float] = []
    lags: list[float] = []
    for k, first in enumerate(range(half // 2, speed.size - half + 1, half)):
        wave = (-1.0) ** k * speed[first : first + half]
        peaks.append(float(wave.max()))
        lags.append(360.0 * frequency * TICK * int(wave.argmax()))
    return peaks, lags


def sine_of(recording: Recording, frequency: float) -> NDArray[np.float64]:
    """Set-points of a recording [rad/s]."""
    return np.asarray(AMPLITUDE * np.sin(2.0 * np.pi * frequency * (recording.time - TICK)))


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Both runs."""
    frequency = whole_ticks(min(FREQUENCY / inertia_ratio(plant, seed, AXIS), top_frequency(plant.axes[AXIS])))
    limit = current_limit(plant.axes[AXIS], frequency)
    with_it, without = (respond(plant, seed, frequency, anti_windup) for anti_windup in (True, False))
    asked = AMPLITUDE / RPM
    higher = Bound(HIGHER_LEAST * max(with_it.peak / RPM, asked))
    rows = (
        Row("peak with", "F21: almost no overshoot", with_it.peak / RPM, "rpm", Bound(0.95 * asked, 1.1 * asked)),
        Row("lag with", "F21: small lag", with_it.lag, "deg", Bound(0.0, 20.0)),
        Row("time at the limit with", "F21: at the limit while accelerating", with_it.saturated, "", Bound(0.05, 0.8)),
        Row("peak without", "F22: overshoot at every peak", without.peak / RPM, "rpm", higher),
        Row("lag without", "F22: clear lag", without.lag, "deg", Bound(LATER_LEAST * with_it.lag)),
        Row("time at the limit without", "F22: longer at the limit", without.saturated, "", Bound(with_it.saturated)),
    )
    panels = tuple(
        _panel(f"{figure}: {how} anti-windup", response)
        for figure, how, response in (("F21", "with", with_it), ("F22", "without", without))
    )
    note = f"axis {AXIS + 1}, {frequency:.3g} Hz, i_q limit {limit:.2f} A, speeds are the feedback's, as in F21 and F22"
    return Outcome(NAME, rows, panels, (note,))


def _panel(title: str, response: Response) -> Panel:
    first = WARM_UP / response.frequency
    part = response.recording.part(first, first + 3.0 / response.frequency)
    time = 1e3 * (part.time - first)
    curves = (
        Curve("set-point", time, sine_of(part, response.frequency) / RPM),
        Curve("speed", time, part.speed / RPM),
        Curve("i_q* [A] x 500", time, part.i_q_ref * 500.0),
    )
    return Panel(title, "time [ms]", "speed [rpm]", curves)
