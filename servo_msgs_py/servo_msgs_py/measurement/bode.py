"""Measure the open loop of a controller on a running axis, beside what the tuning code predicts for it. Pure.

A swept sine is added on the board behind or before a controller, as often as the loop runs. The recorder takes it with
what the loop makes of it; `frequency_response` does the rest. The loops stay closed.

Speed and position loop are measured while the shaft turns at a constant speed, so that friction is a constant; current
loops with a current that holds the rotor (mode TEST), so that no phase current passes zero, where dead time is not
linear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.measurement.access import BoardAccess, MeasurementError, Recording
from servo_msgs_py.measurement.bode_plan import (
    SWEEP_PART,
    Band,
    BodeRequest,
    Settings,
    completed,
    motion_text,
    notes,
    refuse_settings,
)
from servo_msgs_py.measurement.bode_rig import BodeRig
from servo_msgs_py.measurement.frequency_response import Figures, Measured, Response, estimate, figures, joined
from servo_msgs_py.measurement.prediction import Prediction
from servo_msgs_py.measurement.test_signal import full_scale, prepare_test_signal
from servo_msgs_py.tuning.configuration import Board as BoardValues

_CHECKS: Final = 2  # recordings with half the amplitude
_LINEAR, _LINEAR_DEGREES = 0.05, 3.0  # what they may change
_SIGNAL_PART: Final = 0.9  # of a sweep, that a recording has to hold
_LIMIT_PART: Final = 0.98
_VOLTAGE: Final = ("u_d", "u_q")


@dataclass(frozen=True)
class Bode:
    """A measured loop and its prediction."""

    settings: Settings  # of the measurement
    bands: tuple[Band, ...]  # sweeps
    response: Response  # open loop
    figures: Figures  # crossover, margins and resonances of it
    prediction: Prediction  # by the tuning code
    notes: tuple[str, ...]  # for the reader, a sentence each

    @property
    def confirmed(self) -> bool:
        """Whether the data determine the crossover, and half the amplitude does not contradict."""
        crossover = self.figures.crossover
        return crossover is not None and math.isfinite(crossover.sigma)


def measure(
    access: BoardAccess,
    request: BodeRequest,
    *,
    enable: bool = False,
    say: Callable[[str], None] = lambda _: None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Bode:
    """Measure an open loop.

    Parameters
    ----------
    access : BoardAccess
        The board.
    request : BodeRequest
        What to measure.
    enable : bool
        Enable the axis where it is not, and disable it afterwards.
    say : callable
        Gets a sentence about the motion that is about to begin.
    progress : callable
        Gets what is done, and how many recordings of all are.

    Raises
    ------
    MeasurementError
        If it cannot be measured; a loop whose figures are not determined is no error.
    ConfigError
        If there is no prediction: no configuration gives what the board has.
    """
    settings, prediction, bands = completed(access, request)
    refuse_settings(access, settings, bands)
    say(motion_text(settings, bands))
    total = len(bands) * settings.repeats + _CHECKS
    rig = BodeRig(access, settings, say)
    with rig.prepared(enable):
        home = rig.value("position")

        def swept(band: Band, amplitude: float, repeats: int, done: int) -> Response:
            prepare_test_signal(access, settings.axis, settings.signal(band, amplitude))
            taken = []
            if not settings.loop.slow:
                progress("voltage", done, total)
                recording = rig.recorded(band, 0.0, _VOLTAGE)
                _refuse_voltage(access, settings.axis, prediction.it.board, recording)
            for repeat in range(repeats):
                progress(f"{band.f_min:.3g} .. {band.f_max:.3g} Hz", done + repeat, total)
                # Back to where it was: the ways of the recordings do not add up.
                speed = -settings.speed if rig.value("position") > home else settings.speed
                taken.append(rig.recorded(band, speed))
            return _estimated(access, settings, band, taken)

        response = joined(
            [swept(band, settings.amplitude, settings.repeats, k * settings.repeats) for k, band in enumerate(bands)]
        )
        found, told = figures(response), notes(settings, prediction)
        if found.crossover is not None:
            crossover = found.crossover.value
            (band, *_) = [band for band in bands if band.f_min <= crossover <= band.f_max] or bands
            half = figures(swept(band, 0.5 * settings.amplitude, _CHECKS, total - _CHECKS))
            found, note = _compared(found, half)
            told += note
        progress("done", total, total)
    return Bode(settings, bands, response, found, prediction, tuple(told))


def _compared(found: Figures, half: Figures) -> tuple[Figures, list[str]]:
    """Figures whose uncertainty holds what half the amplitude changes; without one where that is too much.

    Steps of a sensor and friction change the figures the more the smaller the test signal is: what half of it changes
    is about what is still wrong with the whole, as long as it is little.
    """
    pairs = ((found.crossover, half.crossover), (found.phase_margin, half.phase_margin))
    compared = [_with_difference(one, other) for one, other in pairs if one is not None and other is not None]
    if len(compared) < len(pairs):
        return _unconfirmed(found), ["half the amplitude gives no result: use a larger amplitude"]
    crossover, margin = compared
    assert half.crossover is not None
    assert half.phase_margin is not None
    if 2.0 * crossover.sigma > _LINEAR * crossover.value or 2.0 * margin.sigma > _LINEAR_DEGREES:
        note = (
            f"half the amplitude gives a crossover of {half.crossover.value:.4g} Hz and a phase margin of "
            f"{half.phase_margin.value:.4g} degrees: friction or the steps of a sensor matter; give a larger amplitude"
        )
        return _unconfirmed(found), [note]
    return replace(found, crossover=crossover, phase_margin=margin), []


def _with_difference(one: Measured, other: Measured) -> Measured:
    return Measured(one.value, max(one.sigma, 0.5 * abs(other.value - one.value)))


def _unconfirmed(found: Figures) -> Figures:
    """The same values, with an unknown uncertainty."""

    def unknown(figure: Measured | None) -> Measured | None:
        return None if figure is None else Measured(figure.value, math.inf)

    return replace(
        found,
        crossover=unknown(found.crossover),
        phase_margin=unknown(found.phase_margin),
        gain_margin=unknown(found.gain_margin),
    )


def _estimated(access: BoardAccess, settings: Settings, band: Band, taken: Sequence[Recording]) -> Response:
    """The open loop within a band."""
    loop = settings.loop
    scale = full_scale(access, loop.point)
    signals = [loop.signals(settings.axis, recording, scale) for recording in taken]
    instrument, error, output = (np.array(rows) for rows in zip(*signals, strict=True))
    _refuse_short_signal(settings, instrument)
    _refuse_saturation(access, settings, error)
    return estimate(band.step, instrument, error, output, band.f_min, band.f_max)


def _refuse_short_signal(settings: Settings, signals: NDArray[np.float64]) -> None:
    """Refuse recordings in which the board has ended the test signal before its time."""
    for signal in signals:
        (active,) = np.nonzero(signal)
        if active.size and active[-1] < _SIGNAL_PART * SWEEP_PART * signal.size:
            raise MeasurementError(
                f"the board has ended the test signal of {axis_name(settings.axis)} before its time: a switch, a "
                "set-point that expired, or another program; look at axisN.limits and axisN.inputs, and try again"
            )


def _refuse_voltage(access: BoardAccess, axis: int, board: BoardValues, recording: Recording) -> None:
    """A voltage at its limit makes another loop of a current loop."""
    d, q = (recording.columns[f"{axis_name(axis)}.{column}"] for column in _VOLTAGE)
    word = int(access.read("param.features")[axis])
    limit = board.voltage_max
    if any(flag.name == "BUS_COMPENSATION" for flag in access.catalogue.active("features", word)):
        limit *= access.read("u_dc")[0] / board("nominal_voltage")
    maximum = float(np.hypot(d, q).max())
    if maximum >= _LIMIT_PART * limit:
        raise MeasurementError(
            f"the voltage of {axis_name(axis)} reaches {maximum:.3g} V with the test signal, "
            f"the bus gives {limit:.3g} V; "
            "give a smaller amplitude, lower param.i_q_limit, or look at the supply"
        )


def _refuse_saturation(access: BoardAccess, settings: Settings, error: NDArray[np.float64]) -> None:
    """A set-point that reaches its limit makes another loop of it."""
    loop = settings.loop
    if not loop.slow:
        return
    variable = "param.speed_limit" if loop.name == "position" else "param.i_q_limit"
    limit, maximum = access.read(variable)[settings.axis], float(np.abs(error).max())
    if maximum >= _LIMIT_PART * limit:
        raise MeasurementError(
            f"the set-point reaches {maximum:.3g} {loop.unit} with the test signal, {variable} is {limit:.3g}; "
            "give a smaller amplitude"
        )
