"""Gains of one axis, as designed and as used after rounding; unstable loops are refused."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.block import block_of, constants_of
from servo_tuning.configuration import FEEDBACKS, Axis, Board, Configuration
from servo_tuning.constants import axis_constants
from servo_tuning.control_loops import ControlLoops, control_loops, pi_of
from servo_tuning.conversion import AxisConstants, Converter, PiRaw
from servo_tuning.errors import ConfigError, Problem, Remedy, Table, checking, exactly, lower
from servo_tuning.gains import Gains, current_bandwidth_min
from servo_tuning.linear import spectral_radius
from servo_tuning.loops import ShaftLoops
from servo_tuning.optional import PARTS, SENSORLESS, SPEED_OBSERVER
from servo_tuning.reading import parse
from servo_tuning.sensorless import Sensorless
from servo_tuning.sensorless_constants import used_observer, used_pll
from servo_tuning.sensors import PllSpeed

DITHER_COUNTS: Final = 4
"""Counts of the encoder per slow tick by which the speed of a shaft at rest may dither (drive/speed_control.c)."""


class GainRow(NamedTuple):
    """One gain: as designed, as the firmware uses it, and its integer."""

    name: str
    unit: str
    designed: float  # in `unit`
    used: float  # after rounding to an integer, in `unit`
    raw: int  # integer of the firmware


@dataclass(frozen=True)
class Tuned(ControlLoops):
    """One axis with its gains and integers."""

    axis: Axis  # of the configuration
    board: Board  # of the configuration
    designed: Gains  # before rounding to integers
    constants: AxisConstants  # the integers
    used_sensorless: Sensorless | None  # observer of the back-EMF, PLL and start-up after rounding; None: unusable
    designed_sensorless: Sensorless | None  # the same before rounding
    unusable: Mapping[str, Problem]  # parts of `PARTS` that the axis does not use and that cannot work: reason

    @property
    def sensorless(self) -> Sensorless:
        """Observer of the back-EMF, PLL and start-up after rounding; only if the part is usable."""
        assert self.used_sensorless is not None
        return self.used_sensorless

    @property
    def block(self) -> dict[str, int]:
        """The configuration block of a board, raw numbers by member."""
        return block_of(self.constants)

    @property
    def oscillation_swing(self) -> float:
        """Smallest swing of the current that the drive finds as an oscillation, peak to peak [A]."""
        lines = COUNTS_PER_TURN / 4
        coarse, speed = 1, self.used.speed
        if self.axis.feedback == FEEDBACKS[0]:
            coarse = math.ceil(lines / min(self.axis("encoder.lines"), lines))
        else:
            speed = self.sensorless.speed
        dither = DITHER_COUNTS * coarse * 2.0 * math.pi / COUNTS_PER_TURN / self.board.tick
        return max(self.axis("limits.current") / 4.0, dither * speed.kp)

    def rows(self) -> Iterator[GainRow]:
        """All gains."""
        d, q, speed = (self.constants[field] for field in ("current_loop.d", "current_loop.q", "speed"))
        assert isinstance(d, PiRaw)
        assert isinstance(q, PiRaw)
        assert isinstance(speed, PiRaw)
        plain = [self.constants[field] for field in ("position_gain", "path_omega_n_ts")]
        raw = [*d[:2], *q[:2], *speed, *(value for value in plain if isinstance(value, int))]
        for (name, unit, designed), (_, _, used), integer in zip(
            self.designed.named(), self.used.named(), raw, strict=True
        ):
            yield GainRow(name, unit, designed, used, integer)
        if self.designed_sensorless is not None:
            yield from self._sensorless_rows(self.designed_sensorless)

    def _sensorless_rows(self, designed: Sensorless) -> Iterator[GainRow]:
        period, used = self.board.period, self.sensorless
        k1, k2, speed = (self.constants[field] for field in ("observer.k1", "observer.k2", "observed_speed"))
        kp, ki = self.constants["pll.kp"], self.constants["pll.ki"]
        assert isinstance(k1, int)
        assert isinstance(k2, int)
        assert isinstance(kp, int)
        assert isinstance(ki, int)
        assert isinstance(speed, PiRaw)
        top = self.axis("motor.pole_pairs") * self.axis("limits.speed")
        gains = [2.0 * design.pll.damping * design.pll.omega_n(top) for design in (designed, used)]
        squares = [design.pll.rate * top for design in (designed, used)]
        yield GainRow("observer K1", "1/s", designed.observer.k1 / period, used.observer.k1 / period, k1)
        yield GainRow("observer K2", "V/(A s)", designed.observer.k2 / period, used.observer.k2 / period, k2)
        yield GainRow("PLL Kp at the speed limit", "1/s", gains[0], gains[1], kp)
        yield GainRow("PLL Ki at the speed limit", "1/s^2", squares[0], squares[1], ki)
        yield GainRow("sensorless speed Kp", "A s/rad", designed.speed.kp, used.speed.kp, speed.kp)
        yield GainRow("sensorless speed Kp Ki Ts", "A s/rad", designed.speed.ki, used.speed.ki, speed.ki)

    def sensorless_shaft(self, speed: float, inertia: float = 1.0) -> ShaftLoops:
        """Sensorless speed loop at a mechanical speed [rad/s]; `inertia` as in `shaft`."""
        pll = self.sensorless.pll
        omega_n = pll.omega_n(self.axis("motor.pole_pairs") * speed)
        sensor = PllSpeed(omega_n, pll.damping, pll.acceleration, pll.load, *pll.size_gains(self.board.tick))
        gains = replace(self.used, speed=self.sensorless.speed)
        return ShaftLoops(self.with_inertia(inertia), gains, self.back_emf, sensor)


def tuned(axis: Axis, configuration: Configuration) -> Tuned:
    """Compute gains and integers of one axis.

    Raises
    ------
    ConfigError
        If a number does not fit its format, or a loop is unstable.
    """
    with checking(configuration.table):
        result = _tuned(axis, configuration, {})
        _refuse_unstable(result)
        unstable = {
            name: reason
            for name, part in PARTS.items()
            if name not in result.unusable and (reason := _instability(result, name)) is not None
        }
        for name, reason in unstable.items():
            if PARTS[name].used(axis):
                raise ConfigError(reason)
        return _tuned(axis, configuration, unstable) if unstable else result


def tuned_axis(table: Table, axis: int) -> Tuned:
    """Gains and integers of one axis of a parsed ``servo.toml``.

    Raises
    ------
    ConfigError
        If the configuration is not possible.
    """
    configuration = parse(table, Catalogue.load())
    return tuned(configuration.axes[axis], configuration)


def _tuned(axis: Axis, configuration: Configuration, unstable: Mapping[str, Problem]) -> Tuned:
    """Compute gains and integers of one axis without the optional parts that are unstable."""
    designed, constants, unusable = integers(axis, configuration, unstable)
    sensorless = None if SENSORLESS in unusable else Sensorless.of(axis, configuration.board)
    block = {**block_of(constants), **axis.members}
    constants = constants_of(block, constants)
    return Tuned(
        **vars(control_loops(block, axis.motor)),
        axis=axis,
        board=configuration.board,
        designed=designed,
        constants=constants,
        used_sensorless=sensorless and _used_sensorless(block, sensorless, axis, configuration),
        designed_sensorless=sensorless,
        unusable=unusable,
    )


def _used_sensorless(
    block: Mapping[str, int], design: Sensorless, axis: Axis, configuration: Configuration
) -> Sensorless:
    return Sensorless(
        observer=used_observer(block, design.observer, configuration.scales),
        pll=used_pll(block, axis, configuration.board, configuration.scales),
        start_up=design.start_up,
        speed=pi_of(block, "observed_speed"),
    )


def integers(
    axis: Axis, configuration: Configuration, off: Mapping[str, Problem]
) -> tuple[Gains, AxisConstants, Mapping[str, Problem]]:
    """Return designed gains, integers, and the reasons of the unused parts of `PARTS` that cannot work.

    Parameters
    ----------
    off : mapping
        Parts to be switched off, with the reasons.

    Raises
    ------
    ConfigError
        If a number does not fit its format, or a part that the axis uses cannot work.
    """
    designed = Gains.of(axis, configuration.board)
    constants = dict(axis_constants(axis, designed, configuration))
    unusable = dict(off)
    to = Converter(axis, configuration.board, configuration.scales)
    for name, part in PARTS.items():
        if name not in unusable:
            try:
                constants |= part.fields(to)
                continue
            except ConfigError as reason:
                if part.used(axis):
                    raise
                unusable[name] = reason.problem
        constants |= part.off
    return designed, constants, unusable


def _refuse_unstable(design: Tuned) -> None:
    current = max(spectral_radius(design.current_loop(which).closed.a) for which in "dq")
    _refuse_radius(design, current, "the sampled loop", "control.current_bandwidth")
    _refuse_unstable_shaft(design, observed=False)


def _instability(design: Tuned, part: str) -> Problem | None:
    """Reason if a loop with an optional part is unstable."""
    try:
        if part == SPEED_OBSERVER:
            _refuse_unstable_shaft(design, observed=True)
        if part == SENSORLESS:
            for turning in (design.sensorless.start_up.minimum_speed, design.axis("limits.speed")):
                radius = spectral_radius(design.sensorless_shaft(turning).speed_alone)
                how = f"at {turning:.3g} rad/s the sensorless speed loop"
                _refuse_radius(design, radius, how, "observer.speed_part")
    except ConfigError as error:
        return error.problem
    return None


def _refuse_unstable_shaft(design: Tuned, *, observed: bool) -> None:
    how = "with the speed observer the sampled loop" if observed else "the sampled loop"
    shaft = design.shaft(observed=observed)
    speed = "control.observer_bandwidth" if observed else "control.speed_bandwidth"
    path = "control.current_bandwidth"
    # first: slow outer loops remain slow when a warning asks for a faster current loop
    wanted = current_bandwidth_min(design.axis.motor, design.board("pwm_frequency"))
    faster = (exactly(path, wanted),) if design.axis(path) < wanted else ()
    _refuse_radius(design, spectral_radius(shaft.speed_alone), how, speed, *faster)
    _refuse_radius(design, spectral_radius(shaft.position.a), how, "control.position_gain", *faster)


def _refuse_radius(design: Tuned, radius: float, how: str, path: str, *before: Remedy) -> None:
    """Refuse an unstable loop; to lower its entry `path` is a remedy after those in `before`."""
    if radius >= 1.0:
        reason = f"{how} is unstable, its largest pole has the magnitude {radius:.3f}"
        raise design.axis.refused(path, reason, *before, lower(path), "correct the motor data")
