"""Configuration of a burst as command line options, and set-up of a recorder for it."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import dataclass, replace
from typing import Final, NoReturn

from servo_msgs_py.catalogue import Catalogue

from servo_bridge.bursts.burst import Channel, channels_of
from servo_bridge.bursts.trigger_text import parse_expression, trigger_of
from servo_bridge.freemaster.errors import RecorderError, StatusError
from servo_bridge.freemaster.recorder import Limits, Recorder, Setup, Trigger
from servo_bridge.tool_values import UsageError, lookup, opened
from servo_bridge.wire.session import Session
from servo_msgs_py import argument

TICK: Final = "tick"
"""PWM periods since the reset of a servo board."""

_FAST, _SLOW = 0, 1
_RATE_TOLERANCE: Final = 0.01


@dataclass(frozen=True)
class Before:
    """Points before the trigger: a fraction of all points, or a number."""

    part: float | None = None  # of all points, 0 .. 1
    points: int | None = None  # number of points

    def of(self, total: int) -> int:
        """Points before the trigger, of `total` points."""
        if self.points is not None:
            return self.points
        assert self.part is not None
        return min(round(self.part * total), max(total - 1, 0))


@dataclass(frozen=True)
class Prepared:
    """A recorder and its configuration."""

    recorder: Recorder  # of the board
    channels: tuple[Channel, ...]  # in the order of a point
    setup: Setup  # configuration
    period_ns: int  # time between two points [ns]; 0: not reported by the board


@dataclass(frozen=True)
class BurstRequest:
    """Configuration of a burst."""

    names: tuple[str, ...]  # variables, elements of arrays or structures
    recorder: int = _FAST  # number of the recorder
    trigger: str | None = None  # such as ``axis1.i_q > 1.0``
    level: bool = False  # trigger also if the condition holds from the start
    before: Before | None = None  # points before the trigger; None: half of them
    points: int | None = None  # number of points; None: as many as fit
    rate: float | None = None  # [Hz]; None: the sampling rate of the recorder

    @classmethod
    def of(cls, args: argparse.Namespace) -> BurstRequest:
        """Create from the options of `add_options`, with ``names`` and ``rate``."""
        if args.level and args.trigger is None:
            raise UsageError("--level needs a trigger; add --trigger")
        if args.before is not None and args.trigger is None:
            raise UsageError("--before needs a trigger; add --trigger")
        return cls(
            tuple(args.names), args.recorder or _FAST, args.trigger, args.level, args.before, args.points, args.rate
        )

    @classmethod
    def parse(cls, text: str) -> BurstRequest:
        """Parse names and options in the form of ``servo-tool record``.

        Raises
        ------
        UsageError
            If they are invalid.
        """
        parser = _Parser(prog="record", add_help=False)
        parser.add_argument("names", nargs="+")
        parser.add_argument("--rate", type=argument.positive)
        add_options(parser)
        try:
            return cls.of(parser.parse_args(shlex.split(text)))
        except ValueError as error:
            raise UsageError(f"{text!r}: {error}") from None

    def with_tick(self) -> BurstRequest:
        """Add the tick, which gives the points their board time."""
        return self if TICK in self.names else replace(self, names=(TICK, *self.names))

    def prepare(self, session: Session, catalogue: Catalogue) -> Prepared:
        """Read the limits of the recorder of the board, and compute its configuration.

        Raises
        ------
        UsageError, UnknownVariableError
            If a name, the trigger or the rate does not match the board.
        RecorderError
            If the board does not have the recorder, or it does not support the configuration.
        """
        names = opened(session.variables, self.names)
        channels = channels_of([(name, *lookup(session.variables, name)) for name in names])
        trigger = None
        if self.trigger is not None:
            trigger = trigger_of(parse_expression(self.trigger), session.variables, catalogue, level=self.level)
        recorder = session.client.recorder(self.recorder)
        try:
            limits = recorder.limits()
        except StatusError as error:
            raise RecorderError(f"the board has no recorder: {error.meaning}") from error
        divider = _divider(self.rate, limits)
        setup = self._setup(channels, divider, trigger, limits)
        return Prepared(recorder, tuple(channels), setup, limits.period_ns * divider)

    def _setup(self, channels: list[Channel], divider: int, trigger: Trigger | None, limits: Limits) -> Setup:
        setup = Setup(tuple(channel.slot for channel in channels), self.points or 0, 0, divider, trigger)
        if trigger is None:
            return setup
        total = setup.points or limits.capacity(setup)
        before = self.before or Before(part=0.5)
        if total is None and before.part is not None:
            raise UsageError("the board does not report the memory size of its recorder; add --points")
        return Setup(setup.slots, setup.points, before.of(total or 0), divider, trigger)


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of a burst to a command."""
    burst = command.add_argument_group("burst", "Use a recorder of the board instead of reading over the line.")
    which = burst.add_mutually_exclusive_group()
    which.add_argument(
        "--fast", dest="recorder", action="store_const", const=_FAST, help="the recorder of the fast loop"
    )
    which.add_argument(
        "--slow", dest="recorder", action="store_const", const=_SLOW, help="the recorder of the slow loop"
    )
    which.add_argument("--recorder", type=argument.whole, metavar="N", help="the recorder with this number")
    burst.add_argument(
        "--trigger",
        metavar="EXPR",
        help="condition, such as 'axis1.i_q > 1.0', 'u_dc < 20', 'axis1.state rising FAULT'",
    )
    burst.add_argument("--level", action="store_true", help="trigger also if the condition holds from the start")
    burst.add_argument("--before", type=_before, metavar="PART", help="points before the trigger (default: 50%%)")
    burst.add_argument("--points", type=argument.whole, metavar="N", help="number of points (default: as many as fit)")


class _Parser(argument.Parser):
    """Parser that raises an error instead of ending the program."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(message)


def _before(text: str) -> Before:
    """Parse ``30%`` or a number of points; else raise `argparse.ArgumentTypeError`."""
    try:
        if text.endswith("%"):
            part = float(text[:-1]) / 100.0
            if 0.0 <= part <= 1.0:
                return Before(part=part)
        elif int(text) >= 0:
            return Before(points=int(text))
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is neither a fraction such as 30% nor a number of points")


def _divider(rate: float | None, limits: Limits) -> int:
    """Divider for a rate [Hz].

    Raises
    ------
    UsageError
        If no integer divider gives the rate.
    """
    if rate is None:
        return 1
    if not rate > 0.0:
        raise UsageError(f"the rate is {rate:g} Hz; write a rate above 0")
    if not limits.period_ns:
        raise UsageError("the board does not report the sampling rate of its recorder; omit --rate")
    full = 1e9 / limits.period_ns
    divider = max(round(full / rate), 1)
    if abs(full / divider / rate - 1.0) > _RATE_TOLERANCE:
        near = sorted({max(int(full / rate), 1), int(full / rate) + 1})
        rates = " or ".join(f"{full / number:g}" for number in near)
        raise UsageError(f"the recorder samples at {full:g} Hz divided by a whole number: {rates} Hz, not {rate:g} Hz")
    return divider
