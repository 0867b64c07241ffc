"""Plan of an open-loop measurement within the limits of the axis: sweeps, amplitude and speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.rounding import rounded_down, rounded_up
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_measurement.access import BoardAccess, MeasurementError, step_of
from servo_measurement.frequency_response import GROUPS
from servo_measurement.prediction import Candidate, Prediction, predict
from servo_measurement.running_axis import SETTLE
from servo_measurement.test_signal import SweptSine, refuse_test_signal

SWEEP_PART: Final = 0.8  # of a recording; the remainder is for the decay of the response
GAIN_MIN: Final = 0.01
"""Smallest part of the bandwidths with which a loop is measured."""

BASE_PART: Final = 0.5  # of the current limit: i_d that holds the rotor during the measurement of a current loop

_CYCLES_MIN: Final = 4.0  # of the lowest frequency in a sweep
_EXTENSION_MAX: Final = 1.3  # the lowest sweep is extended down to f_min by at most this factor, with fewer cycles
_NYQUIST_PART: Final = 0.8
_BELOW, _ABOVE = 5.0, 10.0  # default band around the predicted crossover
_SLOW_PART: Final = 0.4  # of the current limit: largest current at the default amplitude of a slow loop
_FAST_PART: Final = 0.15  # of the current limit: default amplitude of a current loop
_BASE_RATIO: Final = 2.5  # of holding current to amplitude, so that no phase current crosses zero (dead time)
_EXCURSION: Final = 0.7  # of the constant speed: largest speed amplitude, without reversal of the shaft
_DEFAULT_EXCURSION: Final = 30.0  # the same without a constant speed [rad/s]
_SPEED_PART: Final = {"speed": 0.15, "position": 0.1}  # of the speed limit: default speed
_RESOLUTIONS: Final = 20.0  # of the M/T method; below this amplitude quantisation changes the gain by percents
LINE: Final = 0.5  # communication time on a serial line at the beginning and end of a motion [s]
_TIME_MAX: Final = 30.0  # longest motion [s]


@dataclass(frozen=True)
class Loop:
    """Properties of a loop that can be measured."""

    name: str  # on the command line
    point: str  # input of the test signal, a name of ``test_point_t``
    slow: bool  # sampled by the slow loop
    columns: tuple[str, ...]  # recorded variables of the axis in addition to the test signal
    unit: str  # of the test signal

    def signals(self, axis: int, recording: Trace, scale: float) -> tuple[NDArray[np.float64], ...]:
        """Test signal, and input and output of the open loop, each (samples,), in `unit`; `scale`: full scale."""
        name = axis_name(axis)
        first, *others = (recording[f"{name}.{column}"] for column in self.columns)
        signal = scale * recording[f"{name}.test_signal"]
        if self.slow:  # set-point = test signal - output of the open loop
            return signal, first, signal - first
        return signal, others[0] + signal - first, first


LOOPS: Final = {
    loop.name: loop
    for loop in (
        Loop("current", "I_Q", False, ("i_q", "i_q_ref"), "A"),
        Loop("current_d", "I_D", False, ("i_d", "i_d_ref"), "A"),
        Loop("speed", "TORQUE", True, ("i_q_ref",), "A"),
        Loop("position", "SPEED", True, ("speed_ref",), "rad/s"),
    )
}


@dataclass(frozen=True)
class BodeRequest:
    """Specification of a measurement."""

    axis: int  # index
    loop: str  # a name of `LOOPS`
    amplitude: float | None = None  # of the test signal [A], position loop: [rad/s]; None: from limits and prediction
    f_min: float | None = None  # lower end of the band [Hz]; None: a fifth of the predicted crossover
    f_max: float | None = None  # upper end [Hz]; None: ten times the predicted crossover
    speed: float | None = None
    """Constant speed during the measurement [rad/s]; 0: at standstill; None: a part of the speed limit, reduced if
    `travel_max` or the soft limits require it."""
    travel_max: float = math.inf  # largest rotation of the shaft in each direction [rad]
    repeats: int = 4  # recordings per band
    gain: float = 1.0
    """Bandwidths of speed and position control during the measurement, over those of the board, above 0 to 1."""
    groups: int = GROUPS  # of frequencies, per decade
    half: bool = False  # sweep every band as often with half the amplitude
    observed: bool | None = None  # whether the speed observer is on meanwhile; None: as on the board
    candidate: Candidate | None = None  # in use during the measurement; None: what the board has


@dataclass(frozen=True)
class Settings:
    """Complete settings of a measurement: the values of `BodeRequest` with defaults, and derived values."""

    axis: int  # index
    loop: Loop
    amplitude: float  # of the test signal, in the unit of the loop
    f_min: float  # lower end of the band [Hz]
    f_max: float  # upper end of the band [Hz]
    speed: float  # constant speed during the measurement [rad/s]
    travel_max: float  # largest rotation of the shaft in each direction [rad]
    repeats: int  # recordings per band
    gain: float = 1.0  # part of the bandwidths in use
    groups: int = GROUPS  # of frequencies, per decade
    speed_amplitude: float = 0.0  # predicted speed amplitude caused by the test signal [rad/s]
    deceleration: float = math.inf  # of the shaft after the measurement [rad/s^2]

    @property
    def columns(self) -> tuple[str, ...]:
        """Recorded variables of the axis."""
        return ("test_signal", *self.loop.columns)

    def signal(self, band: Band, amplitude: float) -> SweptSine:
        """Test signal of a band; `amplitude` in the unit of the loop."""
        return SweptSine(self.loop.point, amplitude, band.f_min, band.f_max, band.sweep_seconds)

    def travel_per_recording(self, band: Band) -> float:
        """Largest rotation of the shaft during one recording, until its stop begins [rad]."""
        return abs(self.speed) * band.rotation_seconds + self.speed_amplitude / (2.0 * math.pi * band.f_min)

    def travel(self, bands: Sequence[Band]) -> float:
        """Largest rotation of the shaft in any recording, including the stop [rad]."""
        if not self.loop.slow:
            return math.pi  # the rotor aligns with the current vector
        stop = (abs(self.speed) + self.speed_amplitude) ** 2 / (2.0 * self.deceleration)
        return max(map(self.travel_per_recording, bands)) + stop


@dataclass(frozen=True)
class Band:
    """One sweep and its recording."""

    f_min: float  # [Hz]
    f_max: float  # [Hz]
    every: int  # calls of the loop per sample
    samples: int  # of the recording
    step: float  # time between two samples [s]

    @property
    def seconds(self) -> float:
        """Length of the recording [s]."""
        return self.samples * self.step

    @property
    def sweep_seconds(self) -> float:
        """Length of the test signal [s]."""
        return SWEEP_PART * self.seconds

    @property
    def rotation_seconds(self) -> float:
        """Duration of the rotation during the recording [s]."""
        return SETTLE + LINE + self.seconds


def bands_of(f_min: float, f_max: float, capacity: int, slow: bool) -> tuple[Band, ...]:
    """Divide a band `f_min` .. `f_max` [Hz] into parts of one recording each, in ascending order.

    A recording has to contain several cycles of its lowest frequency, and to sample its highest frequency.
    `capacity`: samples of a recording.

    Raises
    ------
    MeasurementError
        If the band is not below half the sampling frequency.
    """
    loop_step = step_of(1, slow)
    highest = 0.5 * _NYQUIST_PART / loop_step
    top = min(f_max, highest)
    if not 0.0 < f_min < highest:
        raise MeasurementError(f"the lower end {f_min:g} Hz of the band must be between 0 and {highest:g} Hz")
    if not f_min < f_max:
        raise MeasurementError(f"the lower end {f_min:g} Hz of the band must be below its upper end, {f_max:g} Hz")
    bands: list[Band] = []
    while True:
        longest = max(int(0.5 * _NYQUIST_PART / (top * loop_step)), 1)
        enough = math.ceil(_CYCLES_MIN / (SWEEP_PART * capacity * f_min * loop_step))
        every = min(longest, enough)
        step = every * loop_step
        lowest = _CYCLES_MIN / (SWEEP_PART * capacity * step)
        bottom = lowest if lowest > _EXTENSION_MAX * f_min else f_min
        bands.insert(0, Band(bottom, top, every, capacity, step))
        if bottom <= f_min:
            return tuple(bands)
        top = bottom


def complete_settings(access: BoardAccess, request: BodeRequest) -> tuple[Settings, Prediction, tuple[Band, ...]]:
    """Complete settings, prediction at the measured speed, and sweeps."""
    axis, loop = request.axis, LOOPS[request.loop]
    if request.gain != 1.0 and not loop.slow:
        raise MeasurementError("a current loop is measured with its own gains; omit the part of the gains")
    prediction = predict(
        access, axis, loop.name, request.speed or 0.0, request.gain, request.candidate, request.observed
    )
    crossover = prediction.margins.crossover or 0.1 * prediction.nyquist
    f_min = crossover / _BELOW if request.f_min is None else request.f_min
    f_max = crossover * _ABOVE if request.f_max is None else request.f_max
    f_max = min(f_max, _NYQUIST_PART * prediction.nyquist)
    travel_max = min(request.travel_max, free_travel(access, axis))
    speed = 0.0 if request.speed is None else request.speed
    deceleration = access.read("param.acceleration_limit")[axis]
    if request.candidate is not None:
        deceleration = min(deceleration, prediction.value("acceleration_limit"))
    settings = Settings(
        axis,
        loop,
        request.amplitude or 0.0,
        f_min,
        f_max,
        speed,
        travel_max,
        request.repeats,
        request.gain,
        request.groups,
        deceleration=deceleration,
    )
    capacity = access.capacity([f"{axis_name(axis)}.{column}" for column in settings.columns])
    bands = bands_of(f_min, f_max, capacity, loop.slow)
    if request.speed is None and loop.slow:
        speed_default = _SPEED_PART[loop.name] * access.read("param.speed_limit")[axis]
        speed = min(
            speed_default, _speed_within(0.8 * travel_max, max(band.rotation_seconds for band in bands), deceleration)
        )
        settings, prediction = replace(settings, speed=speed), replace(prediction, speed=speed)
    if request.amplitude is None:
        settings = replace(settings, amplitude=_default_amplitude(access, settings, prediction))
    if loop.slow:
        settings = replace(settings, speed_amplitude=settings.amplitude * prediction.excursion(f_min, f_max)[0])
    return settings, prediction, bands


def _default_amplitude(access: BoardAccess, settings: Settings, prediction: Prediction) -> float:
    """Largest amplitude without a reversal of the shaft, and with the current below its limit."""
    current = access.read("param.i_q_limit")[settings.axis]
    if not settings.loop.slow:
        return _FAST_PART * current
    speed_gain, current_gain = prediction.excursion(settings.f_min, settings.f_max)
    speed_max = _EXCURSION * abs(settings.speed) if settings.speed else _DEFAULT_EXCURSION
    return min(speed_max / speed_gain, _SLOW_PART * current / current_gain)


def _speed_within(travel: float, seconds: float, deceleration: float) -> float:
    """Constant speed at which the rotation in a time, including the stop, equals `travel` [rad/s]."""
    if math.isinf(travel):
        return math.inf
    speed_of_time = deceleration * seconds
    return math.sqrt(speed_of_time**2 + 2.0 * deceleration * travel) - speed_of_time


def free_travel(access: BoardAccess, axis: int) -> float:
    """Distance to the nearer active soft limit [rad]."""
    word = int(access.read("param.features")[axis])
    if not any(flag.name == "POSITION_LIMITS" for flag in access.catalogue.active("features", word)):
        return math.inf
    here = access.read(f"{axis_name(axis)}.position")[0]
    low, high = (access.read(f"param.position_{end}")[axis] for end in ("min", "max"))
    return max(min(here - low, high - here), 0.0)


def refuse_without_encoder(access: BoardAccess, axis: int) -> None:
    """Raise an error if an axis runs without its encoder."""
    if access.catalogue.label("feedback_kind_t", int(access.read("param.feedback")[axis])) != "ENCODER":
        raise MeasurementError(
            f"{axis_name(axis)} runs without its encoder (param.feedback); only an axis with an encoder can be measured"
        )


def refuse_settings(access: BoardAccess, request: BodeRequest, settings: Settings, bands: Sequence[Band]) -> None:
    """Raise an error if the axis cannot execute the measurement, or a limit of the axis or the user forbids it."""
    name, loop = axis_name(settings.axis), settings.loop
    refuse_without_encoder(access, settings.axis)
    longest = max(band.rotation_seconds for band in bands)
    if longest > _TIME_MAX:
        possible = _lowest_frequency(bands[0].samples, loop.slow)
        raise MeasurementError(
            f"with a lowest frequency of {settings.f_min:.3g} Hz a recording would take {longest:.3g} s, more than "
            f"{_TIME_MAX:g} s; use a lowest frequency of at least {rounded_up(possible):g} Hz"
        )
    speed_limit = access.read("param.speed_limit")[settings.axis]
    current_limit = access.read("param.i_q_limit")[settings.axis]
    if not settings.amplitude > 0.0:
        raise MeasurementError(f"the amplitude {settings.amplitude:g} {loop.unit} must be above 0")
    maximum = (0.5 if loop.slow else BASE_PART / _BASE_RATIO) * current_limit
    if loop.name != "position" and settings.amplitude > maximum:
        raise MeasurementError(
            f"an amplitude of {settings.amplitude:.4g} A is too large for the limit of {name}, {current_limit:.4g} A "
            f"(param.i_q_limit); use an amplitude of at most {rounded_down(maximum):g} A"
        )
    fastest = abs(settings.speed) + settings.speed_amplitude
    if fastest > speed_limit:
        raise MeasurementError(
            f"the speed with the test signal, {fastest:.4g} rad/s, exceeds the limit of {name}, "
            f"{speed_limit:.4g} rad/s (param.speed_limit); {_slower(request, settings, speed_limit)}"
        )
    if settings.speed and not loop.slow:
        raise MeasurementError("a current loop is measured at standstill; omit the speed")
    for band in bands:
        refuse_test_signal(access, settings.signal(band, settings.amplitude))
    if not loop.slow:
        _refuse_brake(access, settings.axis)
    travel = settings.travel(bands)
    if travel > settings.travel_max:
        raise MeasurementError(
            f"{name} would rotate by up to {travel:.3g} rad in each direction, the permitted range is "
            f"{settings.travel_max:.3g} rad; use a lower speed, a smaller amplitude, a higher lowest "
            "frequency, or a wider range"
        )


def _lowest_frequency(capacity: int, slow: bool) -> float:
    """Lowest frequency of a recording of the longest permitted time [Hz]; see `bands_of`."""
    loop_step = step_of(1, slow)
    every = int((_TIME_MAX - SETTLE - LINE) / (capacity * loop_step))
    return _CYCLES_MIN / (SWEEP_PART * capacity * every * loop_step)


def _slower(request: BodeRequest, settings: Settings, limit: float) -> str:
    """What keeps the speed with the test signal within a limit [rad/s]."""
    speed, excursion = abs(settings.speed), settings.speed_amplitude
    if request.amplitude is None and speed:  # the default falls with the speed
        return f"use a speed of at most {rounded_down(limit / (1.0 + _EXCURSION)):g} rad/s"
    if excursion < limit and speed:
        return f"use a speed of at most {rounded_down(limit - excursion):g} rad/s"
    room = limit - speed if speed < limit else (1.0 - _SPEED_PART[settings.loop.name]) * limit
    text = f"use an amplitude of at most {rounded_down(settings.amplitude * room / excursion):g} {settings.loop.unit}"
    return text if speed < limit else f"{text}, and a speed of at most {rounded_down(limit - room):g} rad/s"


def _refuse_brake(access: BoardAccess, axis: int) -> None:
    """Refuse an axis with a brake: mode TEST has no rotor search, its current cannot be relied on to hold the load."""
    brake = access.catalogue.flag("inputs", "BRAKE_OPEN").mask
    if read_block(access, axis)["pins.fitted"] & brake:
        raise MeasurementError(
            f"{axis_name(axis)} has a holding brake (pins.fitted), and mode TEST, used for a current loop, "
            "does not hold a load; remove the load, and the brake from the configuration"
        )


def motion_text(settings: Settings, bands: Sequence[Band]) -> str:
    """Description of the motion."""
    name, loop = axis_name(settings.axis), settings.loop
    travel = settings.travel(bands)
    how = f" in alternating directions at {abs(settings.speed):.4g} rad/s" if settings.speed else ""
    if not loop.slow:
        how = " into alignment with a current vector"
    return (
        f"{name} rotates{how}, up to {travel:.3g} rad in each direction, with a test signal of "
        f"{settings.amplitude:.3g} {loop.unit} from {settings.f_min:.3g} to {settings.f_max:.3g} Hz; Ctrl-C stops it"
    )


def notes(settings: Settings, prediction: Prediction) -> list[str]:
    """Causes of differences between prediction and measurement."""
    if not settings.loop.slow:
        return []
    if settings.speed == 0.0:
        return ["measured at standstill: friction and infrequent encoder edges affect the result; use --speed"]
    resolution = abs(settings.speed) / (prediction.timer_clock * TICK)
    if (
        settings.loop.name == "speed"
        and not prediction.observed
        and settings.speed_amplitude < _RESOLUTIONS * resolution
    ):
        steps = (
            f"speed amplitude {settings.speed_amplitude:.3g} rad/s, resolution of the M/T method {resolution:.2g} rad/s"
        )
        return [f"{steps}: the error of the gain may be some percent; use a larger amplitude or a lower speed"]
    return []
