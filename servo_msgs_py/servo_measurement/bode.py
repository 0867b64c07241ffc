"""Measurement of the open loop of a controller on a running axis, with the prediction of the tuning code.

The board adds a swept sine at the input or output of a controller in every call of the loop. The recorder samples it
with the signals of the loop; `frequency_response` evaluates them. The loops stay closed.

Speed and position loop are measured at a constant speed, so that friction is constant; current loops with a current
that holds the rotor (mode TEST), so that no phase current crosses zero, where dead time is nonlinear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.trace import Trace

from servo_measurement.access import BoardAccess, MeasurementError
from servo_measurement.bode_plan import (
    SWEEP_PART,
    Band,
    BodeRequest,
    Settings,
    complete_settings,
    motion_text,
    notes,
    refuse_settings,
)
from servo_measurement.bode_rig import BodeRig
from servo_measurement.frequency_response import Figures, Measured, Response, estimate, figures, joined
from servo_measurement.prediction import Prediction
from servo_measurement.test_signal import full_scale, prepare_test_signal

_CHECKS: Final = 2  # recordings at half amplitude
_LINEAR, _LINEAR_DEGREES = 0.05, 3.0  # largest change at half amplitude: relative crossover, phase margin [degrees]
_SIGNAL_PART: Final = 0.9  # smallest part of the test signal in a recording
_LIMIT_PART: Final = 0.98
_VOLTAGE: Final = ("u_d", "u_q")


@dataclass(frozen=True)
class Bode:
    """Measured open loop and its prediction."""

    settings: Settings  # of the measurement
    bands: tuple[Band, ...]  # sweeps
    response: Response  # open loop
    half: Response | None  # with half the amplitude, in the band of the crossover, or as requested in every band
    figures: Figures  # its crossover, margins and resonances
    prediction: Prediction  # of the tuning code
    notes: tuple[str, ...]  # remarks, one sentence each

    @property
    def confirmed(self) -> bool:
        """Whether the crossover is determined and does not depend on the amplitude."""
        crossover = self.figures.crossover
        return crossover is not None and math.isfinite(crossover.sigma)


def measure(
    access: BoardAccess,
    request: BodeRequest,
    *,
    enable: bool = False,
    report: Callable[[str], None] = lambda _: None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Bode:
    """Measure an open loop.

    Parameters
    ----------
    access : BoardAccess
        The board.
    request : BodeRequest
        Specification of the measurement.
    enable : bool
        Enable the axis if it is not enabled, and disable it afterwards.
    report : callable
        Called with a sentence about the motion before it begins.
    progress : callable
        Called with the current step, the number of completed recordings and their total number.

    Raises
    ------
    MeasurementError
        If the measurement is not possible; undetermined figures are not an error.
    """
    settings, prediction, bands = complete_settings(access, request)
    refuse_settings(access, request, settings, bands)
    report(motion_text(settings, bands))
    sweeps = len(bands) * settings.repeats
    total = sweeps + (sweeps if request.half else _CHECKS)
    rig = BodeRig(access, settings, report)
    block = None if settings.gain == 1.0 and request.candidate is None else prediction.block
    with rig.prepared(enable, test_mode=not settings.loop.slow, block=block, observed=request.observed):
        initial = rig.value("position")

        def swept(band: Band, amplitude: float, repeats: int, done: int) -> Response:
            prepare_test_signal(access, settings.axis, settings.signal(band, amplitude))
            recordings = []
            if not settings.loop.slow:
                progress("voltage", done, total)
                recording = rig.recorded(band, 0.0, _VOLTAGE)
                _refuse_voltage(access, settings.axis, prediction, recording)
            for repeat in range(repeats):
                progress(f"{band.f_min:.3g} .. {band.f_max:.3g} Hz", done + repeat, total)
                # Return towards the initial position, so that the travel does not accumulate.
                speed = -settings.speed if rig.value("position") > initial else settings.speed
                recordings.append(rig.recorded(band, speed))
            return _estimated(access, settings, band, recordings)

        response = joined(
            [swept(band, settings.amplitude, settings.repeats, k * settings.repeats) for k, band in enumerate(bands)]
        )
        found, remarks = figures(response), notes(settings, prediction)
        half, amplitude = None, 0.5 * settings.amplitude
        if request.half:
            again = settings.repeats
            half = joined([swept(band, amplitude, again, sweeps + k * again) for k, band in enumerate(bands)])
        elif found.crossover is not None:
            crossover = found.crossover.value
            (band, *_) = [band for band in bands if band.f_min <= crossover <= band.f_max] or bands
            half = swept(band, amplitude, _CHECKS, sweeps)
        progress("done", total, total)
    if found.crossover is not None and half is not None:
        found, note = _compared(found, figures(half))
        remarks += note
    return Bode(settings, bands, response, half, found, prediction, tuple(remarks))


def _compared(found: Figures, half: Figures) -> tuple[Figures, list[str]]:
    """Include the change at half amplitude in the uncertainty; reject the figures if it is too large.

    Errors by quantisation and friction are inversely proportional to the amplitude, so this change estimates the
    remaining error at full amplitude.
    """
    pairs = ((found.crossover, half.crossover), (found.phase_margin, half.phase_margin))
    compared = [_with_difference(one, other) for one, other in pairs if one is not None and other is not None]
    if len(compared) < len(pairs):
        return _unconfirmed(found), ["no result at half amplitude: use a larger amplitude"]
    crossover, margin = compared
    assert half.crossover is not None
    assert half.phase_margin is not None
    if 2.0 * crossover.sigma > _LINEAR * crossover.value or 2.0 * margin.sigma > _LINEAR_DEGREES:
        note = (
            f"at half amplitude the crossover is {half.crossover.value:.4g} Hz and the phase margin "
            f"{half.phase_margin.value:.4g} degrees: friction or quantisation matters; use a larger amplitude"
        )
        return _unconfirmed(found), [note]
    return replace(found, crossover=crossover, phase_margin=margin), []


def _with_difference(one: Measured, other: Measured) -> Measured:
    return Measured(one.value, max(one.sigma, 0.5 * abs(other.value - one.value)))


def _unconfirmed(found: Figures) -> Figures:
    """The same values with unknown uncertainty."""

    def unknown(figure: Measured | None) -> Measured | None:
        return None if figure is None else Measured(figure.value, math.inf)

    return replace(
        found,
        crossover=unknown(found.crossover),
        phase_margin=unknown(found.phase_margin),
        gain_margin=unknown(found.gain_margin),
    )


def _estimated(access: BoardAccess, settings: Settings, band: Band, recordings: Sequence[Trace]) -> Response:
    """Open loop in a band."""
    loop = settings.loop
    scale = full_scale(access, loop.point)
    signals = [loop.signals(settings.axis, recording, scale) for recording in recordings]
    instrument, error, output = (np.array(rows) for rows in zip(*signals, strict=True))
    _refuse_short_signal(settings, instrument)
    _refuse_saturation(access, settings, error)
    return estimate(band.step, instrument, error, output, band.f_min, band.f_max, settings.groups)


def _refuse_short_signal(settings: Settings, signals: NDArray[np.float64]) -> None:
    """Raise an error if the board has ended the test signal early."""
    for signal in signals:
        (active,) = np.nonzero(signal)
        if active.size and active[-1] < _SIGNAL_PART * SWEEP_PART * signal.size:
            raise MeasurementError(
                f"the board has ended the test signal of {axis_name(settings.axis)} too early: a switch, an expired "
                "set-point, or another program; check axisN.limits and axisN.inputs, and try again"
            )


def _refuse_voltage(access: BoardAccess, axis: int, prediction: Prediction, recording: Trace) -> None:
    """Raise an error if the voltage reaches its limit, where a current loop is nonlinear."""
    d, q = (recording[f"{axis_name(axis)}.{column}"] for column in _VOLTAGE)
    word = int(access.read("param.features")[axis])
    limit = prediction.voltage_max
    if any(flag.name == "BUS_COMPENSATION" for flag in access.catalogue.active("features", word)):
        limit *= access.read("u_dc")[0] / prediction.value("u_dc_nominal")
    maximum = float(np.hypot(d, q).max())
    if maximum >= _LIMIT_PART * limit:
        raise MeasurementError(
            f"the voltage of {axis_name(axis)} reaches {maximum:.3g} V with the test signal, "
            f"the bus allows {limit:.3g} V; "
            "use a smaller amplitude, lower param.i_q_limit, or check the supply"
        )


def _refuse_saturation(access: BoardAccess, settings: Settings, error: NDArray[np.float64]) -> None:
    """Raise an error if a set-point reaches its limit, where the loop is nonlinear."""
    loop = settings.loop
    if not loop.slow:
        return
    variable = "param.speed_limit" if loop.name == "position" else "param.i_q_limit"
    limit, maximum = access.read(variable)[settings.axis], float(np.abs(error).max())
    if maximum >= _LIMIT_PART * limit:
        raise MeasurementError(
            f"the set-point reaches {maximum:.3g} {loop.unit} with the test signal, {variable} is {limit:.3g}; "
            "use a smaller amplitude"
        )
