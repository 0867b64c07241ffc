"""Measure the open loop of a controller on a running axis, beside what the tuning code predicts for it. Pure.

A swept sine is added on the board behind or before a controller, as often as the loop runs. The recorder takes it with
what the loop makes of it; `frequency_response` does the rest. The loops stay closed.

Speed and position loop are measured while the shaft turns at a constant speed, so that friction is a constant; current
loops with a current that holds the rotor (mode TEST), so that no phase current passes zero, where dead time is not
linear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.measurement.access import (
    BoardAccess,
    MeasurementError,
    Recording,
    faults_refused,
    refuse_faults,
    step_of,
)
from servo_msgs_py.measurement.frequency_response import Figures, Measured, Response, estimate, figures, joined
from servo_msgs_py.measurement.prediction import Prediction, predict
from servo_msgs_py.measurement.test_signal import (
    SweptSine,
    end_test_signal,
    full_scale,
    prepare_test_signal,
    refuse_test_signal,
    start_test_signal,
)
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_msgs_py.tuning.configuration import Board as BoardValues
from servo_msgs_py.units import PERIOD_NS

__all__ = ["LOOPS", "Band", "Bode", "Loop", "Request", "Settings", "bands_of", "measure"]

_SWEEP_PART: Final = 0.8  # of a recording; the rest is for the loop to come to rest
_TURNS_MIN: Final = 4.0  # of the lowest frequency within a sweep of its own
_STRETCH: Final = 1.3  # by which a sweep may begin lower, with fewer turns, before another one is spent on the rest
_NYQUIST_PART: Final = 0.8
_BELOW, _ABOVE = 5.0, 10.0  # default band around the predicted crossover
_SLOW_PART: Final = 0.4  # of the current limit, that the default amplitude of a slow loop asks for
_FAST_PART: Final = 0.15  # the same as amplitude of a current loop
_BASE_PART: Final = 0.5  # of the current limit: i_d that holds the rotor while a current loop is measured
_BASE_OVER: Final = 2.5  # and over the amplitude: no phase current passes zero, where the dead time is not linear
_EXCURSION: Final = 0.7  # of the constant speed: the shaft shall not turn round
_DEFAULT_EXCURSION: Final = 30.0  # without a constant speed [rad/s]
_SPEED_PART: Final = {"speed": 0.15, "position": 0.1}  # of the speed limit: default speed
_CHECKS: Final = 2  # recordings with half the amplitude
_LINEAR, _LINEAR_DEGREES = 0.05, 3.0  # what they may change
_RESOLUTIONS: Final = 20.0  # of the M/T method; below them its steps change the gain by percents
_SIGNAL_PART: Final = 0.9  # of a sweep, that a recording has to hold
_LIMIT_PART: Final = 0.98
_VOLTAGE: Final = ("u_d", "u_q")
_SETTLE: Final = 0.3  # at the constant speed [s]
_LINE: Final = 0.5  # for the exchanges at a serial line by which a motion begins and ends [s]
_TIME_MAX: Final = 30.0  # longest motion [s]
_RENEW: Final = 0.05  # between two writes of a set-point [s]
_SPEED_TOLERANCE: Final = 0.1  # of the constant speed
_AHEAD: Final = 0.25  # of their time, that points are sent, on a slow line too [s]
_RAMP: Final = 0.3  # longest way to the constant speed in a trajectory [s]
_REST_TIME: Final = 5.0
_STILL_LOOKS: Final = 10
_SEARCH_TIME: Final = 8.0
_LOOK: Final = 0.02
_REST_SPEED: Final = 1.0  # [rad/s]
_TICKS_TIME: Final = (1 << 32) * PERIOD_NS * 1e-9  # after which the time of the board begins anew [s]
_OTHER_MOTION: Final = ("EXPIRED", "STARVED", "POSITION", "NOT_HOMED", "INPUT")
"""Limits in which a shaft does not turn as it is asked to."""


@dataclass(frozen=True)
class Loop:
    """One loop that can be measured.

    Attributes
    ----------
    name : str
        For the command line.
    point : str
        Where the test signal is added, a name of ``test_point_t``.
    slow : bool
        Sampled by the slow loop.
    columns : tuple of str
        Variables of the axis to record, besides the test signal.
    unit : str
        Of the test signal.
    """

    name: str
    point: str
    slow: bool
    columns: tuple[str, ...]
    unit: str

    def signals(self, axis: int, recording: Recording, scale: float) -> tuple[NDArray[np.float64], ...]:
        """Test signal, input and output of the open loop, each (samples,); `scale`: full scale of the signal."""
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
class Request:
    """What to measure.

    Attributes
    ----------
    axis : int
        Index.
    loop : str
        A name of `LOOPS`.
    amplitude : float or None
        Of the test signal [A], or [rad/s] for the position loop; None: from limits and prediction.
    f_min, f_max : float or None
        Band [Hz]; None: from a fifth of the predicted crossover to ten times of it.
    speed : float or None
        Constant speed meanwhile [rad/s]; 0: about the position where the shaft is; None: a part of the speed limit
        that `way_max` and the soft limits leave room for.
    way_max : float
        How far the shaft may turn, to each side [rad].
    repeats : int
        Recordings per band.
    """

    axis: int
    loop: str
    amplitude: float | None = None
    f_min: float | None = None
    f_max: float | None = None
    speed: float | None = None
    way_max: float = math.inf
    repeats: int = 4


@dataclass(frozen=True)
class Settings:
    """What is measured.

    Attributes
    ----------
    swing : float
        Speed by which the test signal moves the shaft at most, as predicted [rad/s].
    deceleration : float
        By which the shaft comes to rest afterwards [rad/s^2].
    others
        As those of `Request`, without gaps.
    """

    axis: int
    loop: Loop
    amplitude: float
    f_min: float
    f_max: float
    speed: float
    way_max: float
    repeats: int
    swing: float = 0.0
    deceleration: float = math.inf

    @property
    def names(self) -> list[str]:
        """Variables to record."""
        return [f"{axis_name(self.axis)}.{column}" for column in ("test_signal", *self.loop.columns)]


@dataclass(frozen=True)
class Band:
    """One sweep and its recording.

    Attributes
    ----------
    f_min, f_max : float
        [Hz].
    every : int
        Calls of the loop per sample.
    samples : int
        Of the recording.
    step : float
        Time between two samples [s].
    """

    f_min: float
    f_max: float
    every: int
    samples: int
    step: float

    @property
    def seconds(self) -> float:
        """Length of the recording [s]."""
        return self.samples * self.step

    @property
    def sweep_seconds(self) -> float:
        """Length of the test signal [s]."""
        return _SWEEP_PART * self.seconds


@dataclass(frozen=True)
class Bode:
    """A measured loop and its prediction.

    Attributes
    ----------
    settings : Settings
        With which it was measured.
    bands : tuple of Band
        Sweeps.
    response : Response
        Open loop.
    figures : Figures
        What it amounts to.
    prediction : Prediction
        Of the tuning code.
    notes : tuple of str
        What a reader has to know, a sentence each.
    """

    settings: Settings
    bands: tuple[Band, ...]
    response: Response
    figures: Figures
    prediction: Prediction
    notes: tuple[str, ...]

    @property
    def confirmed(self) -> bool:
        """Whether the data determine the crossover, and half the amplitude does not contradict."""
        crossover = self.figures.crossover
        return crossover is not None and math.isfinite(crossover.sigma)


# ---- what to measure -------------------------------------------------------------------------------------------------


def bands_of(f_min: float, f_max: float, capacity: int, slow: bool) -> tuple[Band, ...]:
    """Divide a band [Hz] so that each part fits a recording of `capacity` points, from low to high frequencies.

    A recording has to be long enough for some turns of its lowest frequency, and sampled often enough for its highest.

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
        enough = math.ceil(_TURNS_MIN / (_SWEEP_PART * capacity * f_min * loop_step))
        every = min(longest, enough)
        step = every * loop_step
        lowest = _TURNS_MIN / (_SWEEP_PART * capacity * step)
        bottom = lowest if lowest > _STRETCH * f_min else f_min
        bands.insert(0, Band(bottom, top, every, capacity, step))
        if bottom <= f_min:
            return tuple(bands)
        top = bottom


def _completed(access: BoardAccess, request: Request) -> tuple[Settings, Prediction, tuple[Band, ...]]:
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
        axis,
        loop,
        request.amplitude or 0.0,
        f_min,
        f_max,
        speed,
        way_max,
        request.repeats,
        deceleration=deceleration,
    )
    bands = bands_of(f_min, f_max, access.capacity(settings.names), loop.slow)
    if request.speed is None and loop.slow:
        wanted = _SPEED_PART[loop.name] * access.read("param.speed_limit")[axis]
        speed = min(wanted, _speed_within(0.8 * way_max, max(map(_time_of, bands)), deceleration))
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


def _refuse_settings(access: BoardAccess, settings: Settings, bands: Sequence[Band]) -> None:
    """Refuse what the axis cannot do, or what its limits or the user forbid."""
    name, loop = axis_name(settings.axis), settings.loop
    if access.catalogue.label("feedback_kind_t", int(access.read("param.feedback")[settings.axis])) != "ENCODER":
        raise MeasurementError(f"{name} runs without its encoder (param.feedback); only loops with one are measured")
    longest = max(map(_time_of, bands))
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
    most = (0.5 if loop.slow else _BASE_PART / _BASE_OVER) * current_limit
    if loop.name != "position" and settings.amplitude > most:
        raise MeasurementError(
            f"an amplitude of {settings.amplitude:.4g} A is too much for the limit of {name}, {current_limit:.4g} A "
            f"(param.i_q_limit); give at most {most:.4g} A"
        )
    if settings.speed and not loop.slow:
        raise MeasurementError("a current loop is measured without a speed; leave it away")
    for band in bands:
        refuse_test_signal(access, _signal(settings, band, settings.amplitude))
    if not loop.slow:
        _refuse_brake(access, settings.axis)
    way = max(_way(settings, band) for band in bands)
    if way > settings.way_max:
        raise MeasurementError(
            f"{name} would turn by up to {way:.3g} rad to each side, more than the {settings.way_max:.3g} rad allowed; "
            "give a lower speed, a smaller amplitude, a higher lowest frequency, or a wider range"
        )


def _refuse_brake(access: BoardAccess, axis: int) -> None:
    """Mode TEST looks for no rotor: behind a holding brake there may be a load that its current does not hold."""
    brake = next(flag.mask for flag in access.catalogue.flags["inputs"] if flag.name == "BRAKE_OPEN")
    if read_block(access, axis)["pins.fitted"] & brake:
        raise MeasurementError(
            f"{axis_name(axis)} has a holding brake (pins.fitted), and mode TEST, in which a current loop is measured, "
            "does not hold a load; take the load off and the brake out of the configuration"
        )


def _signal(settings: Settings, band: Band, amplitude: float) -> SweptSine:
    """Test signal of a band."""
    return SweptSine(settings.loop.point, amplitude, band.f_min, band.f_max, band.sweep_seconds)


def _way(settings: Settings, band: Band) -> float:
    """How far the shaft turns in one recording at most [rad]."""
    if not settings.loop.slow:
        return math.pi  # the rotor goes to where the current vector points
    stop = (abs(settings.speed) + settings.swing) ** 2 / (2.0 * settings.deceleration)
    return _way_turning(settings, band) + stop


def _way_turning(settings: Settings, band: Band) -> float:
    """The same until the shaft is stopped [rad]."""
    return abs(settings.speed) * _time_of(band) + settings.swing / (2.0 * math.pi * band.f_min)


def _time_of(band: Band) -> float:
    """For which the shaft turns in one recording [s]."""
    return _SETTLE + _LINE + band.seconds


# ---- motion ----------------------------------------------------------------------------------------------------------


class _Axis:
    """The axis under test: motions in which it is measured, and the way back from them."""

    def __init__(self, access: BoardAccess, axis: int) -> None:
        self.access, self.axis, self.name = access, axis, axis_name(axis)
        self.modes = access.catalogue.enums["control_mode_t"]

    def value(self, variable: str) -> float:
        return self.access.read(f"{self.name}.{variable}")[0]

    def label(self, variable: str) -> str:
        """Name of an enumeration value."""
        enum = self.access.catalogue[f"{self.name}.{variable}"].enum
        assert enum is not None
        return self.access.catalogue.label(enum, int(self.value(variable)))

    @property
    def substate(self) -> str:
        """Of RUN; empty in another state."""
        return self.label("substate") if self.label("state") == "RUN" else ""

    @property
    def spins(self) -> bool:
        return self.substate == "SPIN"

    def write(self, variable: str, value: float) -> None:
        self.access.write(variable, [value], self.axis)

    def mode(self, mode: str) -> None:
        self.write("cmd.mode", self.modes[mode])

    def until(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for a condition; a `MeasurementError` if it does not come."""
        left = math.ceil(seconds / _LOOK)
        while not condition():
            refuse_faults(self.access, self.axis)
            left -= 1
            if left < 0:
                raise MeasurementError(f"{self.name} {what} within {seconds:g} s")
            self.access.wait(_LOOK)

    def rests(self) -> bool:
        return abs(self.value("speed")) < _REST_SPEED and self.value("speed_ref") == 0.0

    def hold(self) -> None:
        """Stop at the limit and hold the position."""
        self.mode("POSITION")
        self.until(
            lambda: abs(self.value("speed")) < _REST_SPEED and abs(self.value("speed_ref")) < _REST_SPEED,
            _REST_TIME,
            "has not come to rest",
        )

    def stand_still(self, again: Callable[[], None]) -> None:
        """Wait until a rotor that is held by a current swings no more; `again` is called to keep the current up."""
        count = self.access.catalogue[f"{self.name}.position"].lsb
        for _ in range(math.ceil(_REST_TIME / (_STILL_LOOKS * _LOOK))):
            places = []
            for _ in range(_STILL_LOOKS):
                again()
                self.access.wait(_LOOK)
                places.append(self.value("position"))
            if max(places) - min(places) < 1.5 * count:
                return
        raise MeasurementError(f"{self.name} still swings after {_REST_TIME:g} s; keep the shaft from being driven")

    def settle(self, again: Callable[[], None]) -> None:
        """Let the shaft reach its constant speed; `again` is called to keep the set-point up."""
        for _ in range(math.ceil(_SETTLE / _RENEW)):
            again()
            self.access.wait(_RENEW)
            self.refuse_limits()

    def place(self) -> tuple[float, float]:
        """Position and board time [rad, s]."""
        return self.value("position"), self.access.read("tick")[0] * PERIOD_NS * 1e-9

    def refuse_limits(self) -> None:
        """Refuse limits in which the axis does something else than it is asked for."""
        word = int(self.value("limits"))
        for flag in self.access.catalogue.active("limits", word):
            if flag.name in _OTHER_MOTION:
                raise MeasurementError(
                    f"{self.name} is held back. {flag.name}: {flag.cause}. {flag.remedy}".rstrip(". ")
                )

    def travel(self, speed: float, seconds: float) -> None:
        """Turn at a constant speed under position control for a time [s], then hold."""
        acceleration = 0.5 * self.access.read("param.acceleration_limit")[self.axis]
        ramp = max(0.01, min(1.5 * abs(speed) / acceleration, _RAMP))
        place = self.value("position_ref")
        tick = int(self.access.read("tick")[0])
        path = ((_AHEAD, 0.0, 0.0), (ramp, 0.5 * ramp * speed, speed), (seconds, seconds * speed, speed))
        points = []
        for duration, way, velocity in (*path, (ramp, 0.5 * ramp * speed, 0.0)):
            tick += round(duration * 1e9 / PERIOD_NS)
            place += way
            points.append(TimedPoint(self.axis, tick % (1 << 32), place, velocity))
        self.mode("TRAJECTORY")
        self.access.wait(_LOOK)
        if not self.access.write_words("cmd.points", encode_points(self.access.catalogue, points)):
            self.access.wait(_LOOK)
            reason = self.access.catalogue.label("point_refusal_t", int(self.access.read("point_refusal")[0]))
            raise MeasurementError(f"{self.name} refuses to turn at {speed:g} rad/s: {reason}; give a lower speed")
        self.access.wait(_AHEAD + ramp)


@contextmanager
def _prepared(access: BoardAccess, settings: Settings, enable: bool, say: Callable[[str], None]) -> Iterator[_Axis]:
    """The axis in SPIN and at rest, or in TEST; afterwards at rest, in mode and state from before.

    An axis in mode TORQUE holds its position after its set-point has expired. It is left in mode POSITION: mode TORQUE
    would begin anew with no current, and a load would fall.
    """
    it, tested = _Axis(access, settings.axis), not settings.loop.slow
    refuse_faults(access, settings.axis)
    mode = it.value("mode")
    spun = it.spins
    if spun and tested:
        raise MeasurementError(f"{it.name} is enabled; a current loop is measured in mode TEST: disable the axis first")
    if not spun and not enable:
        raise MeasurementError(f"{it.name} is not enabled; enable it before, or let this command do it with --enable")
    if not it.rests():
        raise MeasurementError(f"{it.name} is in motion; bring it to rest first")
    try:
        if not spun:
            it.mode("TEST" if tested else "POSITION")
            it.write("cmd.enable", 1.0)
            if tested:
                it.until(lambda: it.substate == "TEST", _REST_TIME, "has not begun mode TEST")
            else:
                it.until(lambda: it.spins, _SEARCH_TIME, "has not found its rotor")
        yield it
    finally:
        try:
            end_test_signal(access, settings.axis)
            if it.spins:
                it.hold()
        finally:
            if not spun:
                it.write("cmd.i_q", 0.0)
                it.write("cmd.enable", 0.0)
                it.until(lambda: it.substate != "TEST" and not it.spins, _REST_TIME, "has not switched off")
            if mode == it.modes["TORQUE"] and it.spins:
                say(f"{it.name} holds its position in mode POSITION; it was in mode TORQUE, without a set-point")
            else:
                it.write("cmd.mode", mode)
            access.wait(_LOOK)  # until all of it is in force


# ---- the measurement -------------------------------------------------------------------------------------------------


def measure(
    access: BoardAccess,
    request: Request,
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
    request : Request
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
    settings, prediction, bands = _completed(access, request)
    _refuse_settings(access, settings, bands)
    say(_motion_text(settings, bands))
    total = len(bands) * settings.repeats + _CHECKS
    with _prepared(access, settings, enable, say) as axis:
        home = axis.value("position")

        def swept(band: Band, amplitude: float, repeats: int, done: int) -> Response:
            prepare_test_signal(access, settings.axis, _signal(settings, band, amplitude))
            taken = []
            if not settings.loop.slow:
                progress("voltage", done, total)
                recording = _recorded(axis, settings, band, 0.0, _VOLTAGE)
                _refuse_voltage(access, settings.axis, prediction.it.board, recording)
            for repeat in range(repeats):
                progress(f"{band.f_min:.3g} .. {band.f_max:.3g} Hz", done + repeat, total)
                # Back to where it was: the ways of the recordings do not add up.
                speed = -settings.speed if axis.value("position") > home else settings.speed
                taken.append(_recorded(axis, settings, band, speed))
            return _estimated(access, settings, band, taken)

        response = joined(
            [swept(band, settings.amplitude, settings.repeats, k * settings.repeats) for k, band in enumerate(bands)]
        )
        found, notes = figures(response), _notes(settings, prediction)
        if found.crossover is not None:
            crossover = found.crossover.value
            (band, *_) = [band for band in bands if band.f_min <= crossover <= band.f_max] or bands
            half = figures(swept(band, 0.5 * settings.amplitude, _CHECKS, total - _CHECKS))
            found, note = _compared(found, half)
            notes += note
        progress("done", total, total)
    return Bode(settings, bands, response, found, prediction, tuple(notes))


def _compared(found: Figures, half: Figures) -> tuple[Figures, list[str]]:
    """Figures whose uncertainty holds what half the amplitude changes; without one where that is too much.

    Steps of a sensor and friction change the figures the more the smaller the test signal is: what half of it changes
    is about what is still wrong with the whole, as long as it is little.
    """
    pairs = ((found.crossover, half.crossover), (found.phase_margin, half.phase_margin))
    compared = [_with_difference(one, other) for one, other in pairs if one is not None and other is not None]
    if len(compared) < len(pairs):
        return _unconfirmed(found), ["half the amplitude determines nothing: give a larger amplitude"]
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


def _motion_text(settings: Settings, bands: Sequence[Band]) -> str:
    """What the shaft is going to do."""
    name, loop = axis_name(settings.axis), settings.loop
    way = max(_way(settings, band) for band in bands)
    how = f" to and fro at {abs(settings.speed):.4g} rad/s" if settings.speed else ""
    if not loop.slow:
        how = " to where a current holds it"
    return (
        f"{name} turns{how}, up to {way:.3g} rad to each side, with a test signal of {settings.amplitude:.3g} "
        f"{loop.unit} from {settings.f_min:.3g} to {settings.f_max:.3g} Hz; Ctrl-C stops it"
    )


def _notes(settings: Settings, prediction: Prediction) -> list[str]:
    """What makes a difference between prediction and measurement."""
    if not settings.loop.slow:
        return []
    if settings.speed == 0.0:
        return ["measured about standstill: friction and rare encoder edges change what is measured; give --speed"]
    board = prediction.it.board
    resolution = abs(settings.speed) / (board("timer_clock") * board.tick)
    if settings.loop.name == "speed" and not prediction.observed and settings.swing < _RESOLUTIONS * resolution:
        steps = f"the speed swings by {settings.swing:.3g} rad/s, the M/T method has steps of {resolution:.2g} rad/s"
        return [f"{steps}: the gain may be off by some percent; give a larger amplitude or a lower speed"]
    return []


def _recorded(
    axis: _Axis, settings: Settings, band: Band, speed: float, columns: Sequence[str] | None = None
) -> Recording:
    """One recording of one sweep, in motion or at rest; the shaft turns until the memory of the recorder is full.

    Parameters
    ----------
    columns : sequence of str, optional
        Variables of the axis instead of those of the loop.
    """
    access, loop = axis.access, settings.loop
    set_point = ("cmd.speed", speed)
    if not loop.slow:
        set_point = ("cmd.i_q", _BASE_PART * access.read("param.i_q_limit")[axis.axis])
    renewed = not loop.slow
    begun: tuple[float, float] | None = None

    def renew() -> None:
        if renewed:
            axis.write(*set_point)

    def start() -> None:
        nonlocal renewed, begun
        if loop.name == "speed":
            axis.mode("SPEED")
            renewed = True
            axis.settle(renew)
        elif speed:
            axis.travel(speed, _time_of(band))
            axis.settle(renew)
        begun = axis.place()
        renew()
        start_test_signal(access, axis.axis, loop.point)

    def meanwhile(full: bool) -> None:
        nonlocal renewed, begun
        if begun is not None:
            axis.refuse_limits()
        renew()
        if not loop.slow or begun is None:
            return
        here = axis.place()
        if full:
            renewed = False
            _refuse_motion(axis.name, begun, here, speed)
            begun = None
            axis.hold()
        elif abs(here[0] - begun[0]) > _way_turning(settings, band):
            raise MeasurementError(f"{axis.name} has turned farther than it should while it was recorded")

    if loop.slow:
        axis.hold()
    else:
        axis.stand_still(renew)
    names = settings.names if columns is None else [f"{axis.name}.{column}" for column in columns]
    trigger = f"{axis.name}.test_point"
    with faults_refused(access, axis.axis):
        return access.record(names, band.samples, band.every, loop.slow, start, trigger=trigger, meanwhile=meanwhile)


def _refuse_motion(name: str, begun: tuple[float, float], ended: tuple[float, float], speed: float) -> None:
    """Refuse a recording in which the shaft has not turned as it should; places from `_Axis.place`."""
    turned = (ended[0] - begun[0]) / ((ended[1] - begun[1]) % _TICKS_TIME)
    if speed and abs(turned - speed) > _SPEED_TOLERANCE * abs(speed) + _REST_SPEED:
        raise MeasurementError(
            f"{name} turned at {turned:.3g} rad/s instead of {speed:.3g} rad/s while it was recorded; give a speed "
            "that it keeps under its load, or a higher lowest frequency"
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
        if active.size and active[-1] < _SIGNAL_PART * _SWEEP_PART * signal.size:
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
    most = float(np.hypot(d, q).max())
    if most >= _LIMIT_PART * limit:
        raise MeasurementError(
            f"the voltage of {axis_name(axis)} reaches {most:.3g} V with the test signal, the bus gives {limit:.3g} V; "
            "give a smaller amplitude, lower param.i_q_limit, or look at the supply"
        )


def _refuse_saturation(access: BoardAccess, settings: Settings, error: NDArray[np.float64]) -> None:
    """A set-point that reaches its limit makes another loop of it."""
    loop = settings.loop
    if not loop.slow:
        return
    variable = "param.speed_limit" if loop.name == "position" else "param.i_q_limit"
    limit, most = access.read(variable)[settings.axis], float(np.abs(error).max())
    if most >= _LIMIT_PART * limit:
        raise MeasurementError(
            f"the set-point reaches {most:.3g} {loop.unit} with the test signal, {variable} is {limit:.3g}; "
            "give a smaller amplitude"
        )
