"""Bandwidths for the load of an axis: measured, chosen, tried, confirmed, and only then taken.

1. The load is measured with a part of the gains (`resonance`).
2. The highest bandwidths are chosen that keep the margins with every shaft that is possible (`servo_tuning.robust`).
3. The board gets them for a session: the open speed loop and a move are measured. However the program ends, the board
   takes them back itself.
4. If the margins and the move are confirmed, the board gets them until its next reset.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from servo_msgs_py.axis_config_transfer import read_block, send_configuration
from servo_msgs_py.board_port import place
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.rounding import rounded_down, rounded_up
from servo_tuning.errors import Problem, Table, exactly, lower
from servo_tuning.findings import GAIN_MIN
from servo_tuning.linear import Margins
from servo_tuning.remedies import with_value
from servo_tuning.robust import OBSERVED, PHASE_MIN, ShaftModel, robust, stable
from servo_tuning.tuned import Tuned, tuned_axis

from servo_measurement.access import BoardAccess, MeasurementError, refuse_faults
from servo_measurement.bode import Bode
from servo_measurement.bode import measure as measure_open_loop
from servo_measurement.bode_plan import BodeRequest, free_travel
from servo_measurement.position_move import OVERSHOOT_MAX, TOLERANCE, Move, move_and_back
from servo_measurement.prediction import Candidate, is_observed
from servo_measurement.resonance import GROUPS, Resonance, ResonanceRequest, Shaft, fitted
from servo_measurement.resonance import measure as measure_resonance
from servo_measurement.running_axis import RunningAxis, with_observer

DISTANCE: Final = 2.0 * math.pi
"""Of the move, unless the range is smaller [rad]."""

_RANGE_USE: Final = 0.8  # of the permitted range: the rest is for overshoot
_BEYOND: Final = 1.5  # highest measured frequency over that of the resonance
_BELOW: Final = 2.5  # predicted crossover over the lowest measured frequency
_PHASE_ERROR: Final = 3.0  # of a measured margin [degrees]
_GAIN_ERROR: Final = 0.1  # of a measured margin, relative
_ERROR_MAX: Final = 5.0  # root mean square of the difference of measured loop and model, over its standard deviation
_TOLERANCE_MAX: Final = 0.05  # of the move
_ROOM: Final = 1.5  # of a tolerance that is named: the next move differs

TOLERANCE_OPTION: Final = "--tolerance"
"""Option of the commands with another tolerance."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class AutotuneRequest:
    """Specification."""

    axis: int  # index
    speed: float | None = None  # of the shaft during the measurements [rad/s]; None: as of `BodeRequest`
    travel_max: float = math.inf  # largest rotation of the shaft in each direction [rad]
    phase_min: float = PHASE_MIN  # phase margin of speed and position loop [degrees]
    tolerance: float = TOLERANCE  # largest distance to the target of a move that has arrived [rad]


@dataclass(frozen=True)
class Autotuned:
    """Result."""

    request: AutotuneRequest
    resonance: Resonance  # the measured shaft
    before: Tuned  # configuration of the board at the beginning
    after: Tuned  # the chosen configuration
    table: Table  # ``servo.toml`` with it
    bode: Bode  # measured speed loop with it
    confirmed: Shaft  # fitted to that loop
    moves_before: tuple[Move, ...]  # empty: the loops were not stable
    moves: tuple[Move, ...]

    @property
    def shaft(self) -> ShaftModel:
        """The shaft, from the measurement with a part of the gains."""
        return self.resonance.shaft.model

    @cached_property
    def measured(self) -> Margins:
        """Margins of the measured speed loop.

        A crossover on the flank of a resonance is a matter of few points, so they are those of the model that fits all
        points best.
        """
        return self.confirmed.model.within(self.after.shaft()).speed_margins(self.bode.prediction.delay)

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """What is not confirmed; empty: the board has the configuration."""
        return (*self._margin_problems(), *self._move_problems())

    def _margin_problems(self) -> Iterator[Problem]:
        error = math.sqrt(self.confirmed.squares / (2.0 * max(int(self.bode.response.good.sum()), 1)))
        if error > _ERROR_MAX:
            yield Problem(f"the measured speed loop is not that of motor and load: the error is {error:.2g} sigma")
        margins, phase_min = self.measured, self.request.phase_min
        if not stable(self.confirmed.model, self.after):
            yield Problem("with the shaft that fits the measured loop, speed or position loop are unstable")
        if margins.phase is not None and abs(margins.phase) < phase_min - _PHASE_ERROR:
            yield Problem(f"the measured phase margin is {abs(margins.phase):.1f} degrees instead of {phase_min:g}")
        if margins.gain is not None and margins.gain < GAIN_MIN * (1.0 - _GAIN_ERROR):
            yield Problem(f"the measured gain margin is {margins.gain:.2f} instead of {GAIN_MIN:g}")

    def _move_problems(self) -> Iterator[Problem]:
        tolerance, name = self.request.tolerance, axis_name(self.request.axis)
        if not all(move.figures.arrived for move in self.moves):
            error = max((move.figures.error for move in self.moves), key=abs)
            needed = rounded_up(_ROOM * max(np.abs(move.rest).max() for move in self.moves))
            fact = f"a move ends {error:+.3g} rad from its target, more than {tolerance:g} rad"
            reason = "with these bandwidths friction holds the shaft for long"
            if needed > _TOLERANCE_MAX * self.moves[0].distance:
                yield Problem(fact, advice=f"check {name}.limits, and the load")
            else:
                yield Problem(f"{fact}: {reason}", remedies=(exactly(TOLERANCE_OPTION, needed),))
        overshoot = max(move.figures.overshoot for move in self.moves)
        if overshoot > max(OVERSHOOT_MAX * self.moves[0].distance, tolerance):
            yield Problem(f"a move overshoots by {overshoot:.3g} rad", remedies=(lower("limits.acceleration"),))


def autotune(
    access: BoardAccess,
    request: AutotuneRequest,
    base: Table,
    *,
    report: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda *_: None,
    keep: Callable[[Autotuned], None] = lambda _: None,
) -> Autotuned:
    """Choose, try, confirm and take bandwidths.

    Parameters
    ----------
    access : BoardAccess
        The board, with a disabled axis.
    request : AutotuneRequest
        Specification.
    base : mapping
        Parsed ``servo.toml``, with the configuration that the board has.
    report : callable
        Called with a sentence about each motion before it begins.
    progress : callable
        Called with the current step, the number of completed recordings and their total number.
    keep : callable
        Called with the result, before the board takes a confirmed configuration: to write its file.

    Raises
    ------
    ConfigError
        If no configuration keeps the margins.
    MeasurementError
        If a measurement is not possible; the board has its configuration from before.
    """
    axis, name = request.axis, axis_name(request.axis)
    _refuse(access, axis, tuned_axis(base, axis))
    before = tuned_axis(with_value(base, f"{name}.{OBSERVED}", is_observed(access, axis)), axis)
    rig, travel = RunningAxis(access, axis, report), min(request.travel_max, free_travel(access, axis))
    distance = min(DISTANCE, _RANGE_USE * travel)
    if request.tolerance > _TOLERANCE_MAX * distance:
        fact = f"a tolerance of {request.tolerance:g} rad is too large for a move by {distance:.3g} rad"
        raise MeasurementError(fact, exactly(TOLERANCE_OPTION, rounded_down(_TOLERANCE_MAX * distance)))
    resonance = measure_resonance(
        access,
        ResonanceRequest(axis, request.speed, request.travel_max),
        enable=True,
        report=report,
        progress=progress,
    )
    shaft, possible = resonance.shaft.model, resonance.shaft.possible
    table = robust(base, axis, shaft, possible, request.phase_min, rig.attend)
    after = tuned_axis(table, axis)
    moves_before: list[Move] = []
    if all(stable(one, before) for one in possible):
        report(f"{name} moves by {distance:.3g} rad and back, with its present configuration")
        moves_before = move_and_back(rig, distance, before.axis("control.position_gain"), request.tolerance)
    bode = measure_open_loop(
        access, _bode_request(request, shaft, after), enable=True, report=report, progress=progress
    )
    report(f"{name} moves by {distance:.3g} rad and back, with the chosen configuration")
    moves = move_and_back(
        rig, distance, after.axis("control.position_gain"), request.tolerance, after.block, after.observed
    )
    confirmed = fitted(bode.prediction, bode.response)
    found = Autotuned(request, resonance, before, after, table, bode, confirmed, tuple(moves_before), tuple(moves))
    keep(found)
    if not found.problems:
        features = with_observer(access, access.read_words("param.features")[axis], after.observed)
        send_configuration(access, {axis: after.block})
        if not access.write_words("param.features", [features], axis):  # the block brings its own
            raise MeasurementError(f"the board refuses param.features = {features} of {name} after its configuration")
    return found


def _refuse(access: BoardAccess, axis: int, before: Tuned) -> None:
    """Raise an error if the board is not in the state that the file and the measurements need."""
    name = axis_name(axis)
    if read_block(access, axis) != before.block:
        raise MeasurementError(
            f"{name} of the board has another configuration than the file: send it first (servo-tool tune), or use the "
            "file of the board"
        )
    refuse_faults(access, axis)
    if place(access, axis) != "STOP":
        raise MeasurementError(f"{name} is enabled: disable it first, the configuration is changed at rest")


def _bode_request(request: AutotuneRequest, shaft: ShaftModel, after: Tuned) -> BodeRequest:
    """Measurement of the speed loop with the chosen configuration, from below its crossover to above the resonance."""
    crossover = shaft.within(after.shaft()).speed_margins().crossover
    lowest = None if crossover is None else min(crossover, after.axis("control.speed_bandwidth")) / _BELOW
    highest = None
    if shaft.load is not None and crossover is not None:
        highest = max(_BEYOND * shaft.load.resonance(shaft.inertia), 10.0 * crossover)
    return BodeRequest(
        request.axis,
        "speed",
        f_min=lowest,
        f_max=highest,
        speed=request.speed,
        travel_max=request.travel_max,
        groups=GROUPS,
        observed=after.observed,
        candidate=Candidate(after.block, shaft),
    )
