"""F21 and F22: sinusoidal speed that exceeds the current limit, with and without anti-windup."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.plant_limits import inertia_ratio
from servo_twin.validation.experiments.rig import RPM, largest, record, set_up, spinning

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

ACCELERATION_RATIO: Final = 0.88
"""Acceleration with the limited current, relative to the required one, as with 1 A and the shaft of F21."""

CURRENT_MAX: Final = 4.0  # limit of the drive [A]

PEAK_RATIO_MIN: Final = 1.1
"""Smallest ratio of the peaks without and with anti-windup."""

LAG_RATIO_MIN: Final = 1.25
"""Smallest ratio of the lags without and with anti-windup; friction reduces the windup."""


def whole_ticks(frequency: float) -> float:
    """Nearest frequency with a quarter period of whole slow ticks [Hz]."""
    return 0.25 / (TICK * max(round(0.25 / (TICK * frequency)), 1))


def current_limit(axis: AxisPlant, frequency: float) -> float:
    """Current limit for the same saturation as with 1 A and the shaft of F21 [A], in steps of 0.01 A."""
    torque = ACCELERATION_RATIO * axis.inertia * AMPLITUDE * 2.0 * np.pi * frequency
    return float(np.clip(round(torque / axis.torque_constant, 2), 0.1, CURRENT_MAX))


def top_frequency(axis: AxisPlant) -> float:
    """Highest frequency with a feasible current limit [Hz]."""
    return CURRENT_MAX * axis.torque_constant / (ACCELERATION_RATIO * axis.inertia * AMPLITUDE * 2.0 * np.pi)


def respond(plant: PlantConfig, seed: int, frequency: float, anti_windup: bool) -> Trace:
    """Run a sine of this frequency [Hz]; returns the last periods."""
    limit, warm_up = current_limit(plant.axes[AXIS], frequency), WARM_UP / frequency
    with spinning(plant, seed) as board:
        parameters = {"i_q_limit": limit, "acceleration_limit": largest(board, "acceleration_limit")}
        set_up(board, AXIS, "SPEED", parameters=parameters, ANTI_WINDUP=anti_windup)

        def act(k: int) -> None:
            write_axis(board, "cmd.speed", AXIS, AMPLITUDE * np.sin(2.0 * np.pi * frequency * k * TICK))

        return record(board, [AXIS], warm_up + MEASURED / frequency, act)[AXIS].part(warm_up)


def half_waves(speed: NDArray[np.float64], frequency: float) -> tuple[list[float], list[float]]:
    """Height [rad/s] and lag [degrees] of every peak; the sine of the set-point starts with the signal.

    Each peak is searched in the half period after the peak of the set-point.
    """
    half = round(0.5 / frequency / TICK)
    peaks: list[float] = []
    lags: list[float] = []
    for k, first in enumerate(range(half // 2, speed.size - half + 1, half)):
        wave = (-1.0) ** k * speed[first : first + half]
        peaks.append(float(wave.max()))
        lags.append(360.0 * frequency * TICK * int(wave.argmax()))
    return peaks, lags


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both runs: mean peak of the speed feedback, its lag, and the fraction of the time at the current limit."""
    frequency = whole_ticks(min(FREQUENCY / inertia_ratio(plant, seed, AXIS), top_frequency(plant.axes[AXIS])))
    limit = current_limit(plant.axes[AXIS], frequency)
    both = with_it, without = [respond(plant, seed, frequency, anti_windup) for anti_windup in (True, False)]
    waves = [half_waves(r["speed"], frequency) for r in both]
    peaks, lags = ([float(np.mean(wave[k])) for wave in waves] for k in range(2))
    lsb = Catalogue.load()["param.i_q_limit"].lsb
    saturated = [float(np.mean(np.abs(r["i_q_ref"]) >= limit - 2.0 * lsb)) for r in both]
    commanded, higher = AMPLITUDE / RPM, peaks[0] / RPM
    judge = Judge()
    yield judge(
        "peak with anti-windup", higher, "rpm", 0.95 * commanded, 1.1 * commanded, reference="F21: almost no overshoot"
    )
    yield judge("lag with anti-windup", lags[0], "deg", 0.0, 20.0, reference="F21: small lag")
    yield judge(
        "time at the limit with anti-windup",
        saturated[0],
        "",
        0.05,
        0.8,
        reference="F21: at the limit while accelerating",
    )
    minimum = PEAK_RATIO_MIN * max(higher, commanded)
    yield judge("peak without anti-windup", peaks[1] / RPM, "rpm", minimum, reference="F22: overshoot at every peak")
    yield judge("lag without anti-windup", lags[1], "deg", LAG_RATIO_MIN * lags[0], reference="F22: clear lag")
    yield judge(
        "time at the limit without anti-windup", saturated[1], "", saturated[0], reference="F22: longer at the limit"
    )
    yield _panel("F21: with anti-windup", with_it, frequency)
    yield _panel("F22: without anti-windup", without, frequency)
    yield f"axis {AXIS + 1}, {frequency:.3g} Hz, i_q limit {limit:.2f} A, speeds are the feedback's, as in F21 and F22"


def _panel(title: str, recording: Trace, frequency: float) -> Panel:
    first = WARM_UP / frequency
    part = recording.part(first, first + 3.0 / frequency)
    time = 1e3 * (part.time - first)
    commanded = AMPLITUDE * np.sin(2.0 * np.pi * frequency * (part.time - TICK))
    curves = (
        Curve("set-point", time, commanded / RPM),
        Curve("speed", time, part["speed"] / RPM),
        Curve("i_q* [A] x 500", time, part["i_q_ref"] * 500.0),
    )
    return Panel(title, "time [ms]", "speed [rpm]", curves)
