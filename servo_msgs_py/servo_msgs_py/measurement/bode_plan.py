"""What a measurement of an open loop is: sweeps, amplitude and speed, as the axis permits them. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.measurement.access import BoardAccess, MeasurementError, Recording, step_of
from servo_msgs_py.measurement.prediction import Prediction, predict
from servo_msgs_py.measurement.test_signal import SweptSine, refuse_test_signal

SWEEP_PART: Final = 0.8  # of a recording; the rest is for the loop to come to rest
BASE_PART: Final = 0.5  # of the current limit: i_d that holds the rotor while a current loop is measured
SETTLE: Final = 0.3  # at the constant speed [s]

_TURNS_MIN: Final = 4.0  # of the lowest frequency within a sweep of its own
_STRETCH: Final = 1.3  # by which a sweep may begin lower, with fewer turns, before another one is spent on the rest
_NYQUIST_PART: Final = 0.8
_BELOW, _ABOVE = 5.0, 10.0  # default band around the predicted crossover
_SLOW_PART: Final = 0.4  # of the current limit, that the default amplitude of a slow loop asks for
_FAST_PART: Final = 0.15  # the same as amplitude of a current loop
_BASE_OVER: Final = 2.5  # and over the amplitude: no phase current passes zero, where the dead time is not linear
_EXCURSION: Final = 0.7  # of the constant speed: the shaft shall not turn round
_DEFAULT_EXCURSION: Final = 30.0  # without a constant speed [rad/s]
_SPEED_PART: Final = {"speed": 0.15, "position": 0.1}  # of the speed limit: default speed
_RESOLUTIONS: Final = 20.0  # of the M/T method; below them its steps change the gain by percents
_LINE: Final = 0.5  # for the exchanges at a serial line by which a motion begins and ends [s]
_TIME_MAX: Final = 30.0  # longest motion [s]


@dataclass(frozen=True)
class Loop:
    """One loop that can be measured."""

    name: str  # for the command line
    point: str  # where the test signal is added, a name of ``test_point_t``
    slow: bool  # sampled by the slow loop
    columns: tuple[str, ...]  # variables of the axis to record, besides the test signal
    unit: str  # of the test signal

    def signals(self, axis: int, recording: Recording, scale: float) -> tuple[NDArray[np.float64], ...]:
        """Test signal, and input and output of the open loop, each (samples,), in `unit`; `scale`: full scale."""
        name = axis_name(axis)
        first, *others = (recording.columns[f"{name}.{column}"] for column in self.columns)
        signal = scale * recording.columns[f"{name}.test_signal"]
        if self.slow:  # the set-point holds the signal; the loop gives back the rest of it, with the opposite sign
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
    """What to measure."""

    axis: int  # index
    loop: str  # a name of `LOOPS`
    amplitude: float | None = None  # of the test signal [A], position loop: [rad/s]; None: from limits and prediction
    f_min: float | None = None  # lower end of the band [Hz]; None: a fifth of the predicted crossover
    f_max: float | None = None  # upper end [Hz]; None: ten times the predicted crossover
    speed: float | None = None
    """Constant speed during the measurement [rad/s]; 0: about the position where the shaft is; None: a part of the
    speed limit that `way_max` and the soft limits leave room for."""
    way_max: float = math.inf  # largest angle of the shaft, to each side [rad]
    repeats: int = 4  # recordings per band


@dataclass(frozen=True)
class Settings:
    """What is measured: the fields of `BodeRequest` without gaps, and what follows from them."""

    axis: int  # index
    loop: Loop
    amplitude: float  # of the test signal, in the unit of the loop
    f_min: float  # lower end of the band [Hz]
    f_max: float  # upper end of the band [Hz]
    speed: float  # constant speed during the measurement [rad/s]
    way_max: float  # largest angle of the shaft, to each side [rad]
    repeats: int  # recordings per band
    swing: float = 0.0  # largest speed by which the test signal moves the shaft, as predicted [rad/s]
    deceleration: float = math.inf  # with which the shaft comes to rest afterwards [rad/s^2]

    @property
    def columns(self) -> tuple[str, ...]:
        """Variables of the axis to record."""
        return ("test_signal", *self.loop.columns)

    def signal(self, band: Band, amplitude: float) -> SweptSine:
        """Test signal of a band; `amplitude` in the unit of the loop."""
        return SweptSine(self.loop.point, amplitude, band.f_min, band.f_max, band.sweep_seconds)

    def way_turning(self, band: Band) -> float:
        """How far the shaft turns in one recording at most, until it is stopped [rad]."""
        return abs(self.speed) * band.turning_seconds + self.swing / (2.0 * math.pi * band.f_min)

    def way(self, bands: Sequence[Band]) -> float:
        """How far it turns in one of all recordings at most [rad]."""
        if not self.loop.slow:
            return math.pi  # the rotor goes to where the current vector points
        stop = (abs(self.speed) + self.swing) ** 2 / (2.0 * self.deceleration)
        return max(map(self.way_turning, bands)) + stop


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
    def turning_seconds(self) -> float:
        """For which the shaft turns in the recording [s]."""
        return SETTLE + _LINE + self.seconds


def bands_of(f_min: float, f_max: float, capacity: int, slow: bool) -> tuple[Band, ...]:
    """Divide a band `f_min` .. `f_max` [Hz] so that each part fits a recording, from low to high frequencies.

    A recording has to be long enough for some turns of its lowest frequency, and sampled often enough for its highest.
    `capacity`: samples of a recording.

    Raises
    ------
    MeasurementError
        If there is no such band below half the sampling frequency.
    """
    loop_step = step_of(1, slow)
    highest = 0.5 * _NYQUIST_PART / loop_step
    top = min(f_max, highest)
    if not 0.0 < f_min < top:
        raise MeasurementError(f"the band {f_min:g} .. {f_max:g} Hz has to lie between 0 and {highest:g} Hz")
    bands: list[Band] = []
    while True:
        longest = max(int(0.5 * _NYQUIST_PART / (top * loop_step)), 1)
        enough = math.ceil(_TURNS_MIN / (SWEEP_PART * capacity * f_min * loop_step))
        every = min(longest, enough)
        step = every * loop_step
        lowest = _TURNS_MIN / (SWEEP_PART * capacity * step)
        bottom = lowest if lowest > _STRETCH * f_min else f_min
        bands.insert(0, Band(bottom, top, every, capacity, step))
        if bottom <= f_min:
            return tuple(bands)
        top = bottom


def completed(access: BoardAccess, request: BodeRequest) -> tuple[Settings, Prediction, tuple[Band, ...]]:
    """What is measured, the prediction at its speed, and the sweeps."""
    axis, loop = request.axis, LOOPS[request.loop]
    prediction = predict(access, axis, loop.name, request.speed or 0.0)
    crossover = prediction.margins.crossover or 0.1 * prediction.nyquist
    f_min = crossover / _BELOW if request.f_min is None else request.f_min
    f_max = crossover * _ABOVE if request.f_max is None else request.f_max
    f_max = min(f_max, _NYQUIST_PART * prediction.nyquist)
    way_max = min(request.way_max, _room(access, axis))
    speed = 0.0 if request.speed is None else request.speed
    deceleration = access.read("param.acceleration_limit")[axis]
    settings = Settings(
        axis, loop, request.amplitude or 0.0, f_min, f_max, speed, way_max, request.repeats, deceleration=deceleration
    )
    capacity = access.capacity([f"{axis_name(axis)}.{column}" for column in settings.columns])
    bands = bands_of(f_min, f_max, capacity, loop.slow)
    if request.speed is None and loop.slow:
        wanted = _SPEED_PART[loop.name] * access.read("param.speed_limit")[axis]
        speed = min(wanted, _speed_within(0.8 * way_max, max(band.turning_seconds for band in bands), deceleration))
        settings, prediction = replace(settings, speed=speed), replace(prediction, speed=speed)
    if request.amplitude is None:
        settings = replace(settings, amplitude=_default_amplitude(access, settings, prediction))
    if loop.slow:
        settings = replace(settings, swing=settings.amplitude * prediction.excursion(f_min, f_max)[0])
    return settings, prediction, bands


def _default_amplitude(access: BoardAccess, settings: Settings, prediction: Prediction) -> float:
    """As much as the limits allow without the shaft turning round, or a current reaching its limit."""
    current = access.read("param.i_q_limit")[settings.axis]
    if not settings.loop.slow:
        return _FAST_PART * current
    speed_gain, current_gain = prediction.excursion(settings.f_min, settings.f_max)
    room = _EXCURSION * abs(settings.speed) if settings.speed else _DEFAULT_EXCURSION
    return min(room / speed_gain, _SLOW_PART * current / current_gain)


def _speed_within(way: float, seconds: float, deceleration: float) -> float:
    """Speed at which a shaft turns for a time and comes to rest within a way [rad/s]."""
    if math.isinf(way):
        return math.inf
    turning = deceleration * seconds
    return math.sqrt(turning**2 + 2.0 * deceleration * way) - turning


def _room(access: BoardAccess, axis: int) -> float:
    """Way to the nearer soft limit that is in force [rad]."""
    word = int(access.read("param.features")[axis])
    if not any(flag.name == "POSITION_LIMITS" for flag in access.catalogue.active("features", word)):
        return math.inf
    here = access.read(f"{axis_name(axis)}.position")[0]
    low, high = (access.read(f"param.position_{end}")[axis] for end in ("min", "max"))
    return max(min(here - low, high - here), 0.0)


def refuse_settings(access: BoardAccess, settings: Settings, bands: Sequence[Band]) -> None:
    """Refuse what the axis cannot do, or what its limits or the user forbid."""
    name, loop = axis_name(settings.axis), settings.loop
    if access.catalogue.label("feedback_kind_t", int(access.read("param.feedback")[settings.axis])) != "ENCODER":
        raise MeasurementError(f"{name} runs without its encoder (param.feedback); only loops with one are measured")
    longest = max(band.turning_seconds for band in bands)
    if longest > _TIME_MAX:
        raise MeasurementError(
            f"from {settings.f_min:.3g} Hz on a recording would take {longest:.3g} s, more than {_TIME_MAX:g} s; "
            "give a higher lowest frequency"
        )
    speed_limit = access.read("param.speed_limit")[settings.axis]
    current_limit = access.read("param.i_q_limit")[settings.axis]
    if not settings.amplitude > 0.0:
        raise MeasurementError(f"the amplitude {settings.amplitude:g} {loop.unit} is not above 0")
    fastest = abs(settings.speed) + settings.swing
    if fastest > speed_limit:
        raise MeasurementError(
            f"{fastest:.4g} rad/s with the test signal are above the limit of {name}, "
            f"{speed_limit:.4g} rad/s (param.speed_limit); give a lower speed"
        )
    maximum = (0.5 if loop.slow else BASE_PART / _BASE_OVER) * current_limit
    if loop.name != "position" and settings.amplitude > maximum:
        raise MeasurementError(
            f"an amplitude of {settings.amplitude:.4g} A is too much for the limit of {name}, {current_limit:.4g} A "
            f"(param.i_q_limit); give at most {maximum:.4g} A"
        )
    if settings.speed and not loop.slow:
        raise MeasurementError("a current loop is measured without a speed; leave it away")
    for band in bands:
        refuse_test_signal(access, settings.signal(band, settings.amplitude))
    if not loop.slow:
        _refuse_brake(access, settings.axis)
    way = settings.way(bands)
    if way > settings.way_max:
        raise MeasurementError(
            f"{name} would turn by up to {way:.3g} rad to each side, more than the {settings.way_max:.3g} rad allowed; "
            "give a lower speed, a smaller amplitude, a higher lowest frequency, or a wider range"
        )


def _refuse_brake(access: BoardAccess, axis: int) -> None:
    """Mode TEST looks for no rotor: behind a holding brake there may be a load that its current does not hold."""
    brake = access.catalogue.flag("inputs", "BRAKE_OPEN").mask
    if read_block(access, axis)["pins.fitted"] & brake:
        raise MeasurementError(
            f"{axis_name(axis)} has a holding brake (pins.fitted), and mode TEST, in which a current loop is measured, "
            "does not hold a load; take the load off and the brake out of the configuration"
        )


def motion_text(settings: Settings, bands: Sequence[Band]) -> str:
    """What the shaft is going to do."""
    name, loop = axis_name(settings.axis), settings.loop
    way = settings.way(bands)
    how = f" to and fro at {abs(settings.speed):.4g} rad/s" if settings.speed else ""
    if not loop.slow:
        how = " to where a current holds it"
    return (
        f"{name} turns{how}, up to {way:.3g} rad to each side, with a test signal of {settings.amplitude:.3g} "
        f"{loop.unit} from {settings.f_min:.3g} to {settings.f_max:.3g} Hz; Ctrl-C stops it"
    )


def notes(settings: Settings, prediction: Prediction) -> list[str]:
    """What makes a difference between prediction and measurement."""
    if not settings.loop.slow:
        return []
    if settings.speed == 0.0:
        return ["measured at standstill: friction and rare encoder edges affect the result; give --speed"]
    board = prediction.it.board
    resolution = abs(settings.speed) / (board("timer_clock") * board.tick)
    if settings.loop.name == "speed" and not prediction.observed and settings.swing < _RESOLUTIONS * resolution:
        steps = f"the speed swings by {settings.swing:.3g} rad/s, the M/T method has steps of {resolution:.2g} rad/s"
        return [f"{steps}: the gain may be off by some percent; give a larger amplitude or a lower speed"]
    return []
