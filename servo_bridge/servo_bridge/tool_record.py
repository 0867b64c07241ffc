"""``servo-tool record`` with the recorder of the board: a burst at the rate of its loops, around a trigger."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from servo_bridge.burst import Burst, burst_of, channels_of
from servo_bridge.burst_files import writer_for
from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.errors import RecorderError, StatusError
from servo_bridge.freemaster.recorder import Limits, Recorder, Setup, State, Trigger, read_points
from servo_bridge.tool_commands import record as record_rows
from servo_bridge.tool_commands import select, warn
from servo_bridge.tool_progress import ProgressLine
from servo_bridge.tool_values import UsageError, opened
from servo_bridge.trigger_text import parse_expression, trigger_of

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context

__all__ = ["Before", "add_options", "before_text", "record"]

_FAST, _SLOW = 0, 1
_POLL: Final = 0.05  # between two questions for the state [s]
_GRACE: Final = 2.0  # in which a recorder that was told to stop has to [s]
_RATE_TOLERANCE: Final = 0.01


@dataclass(frozen=True)
class Before:
    """How much of a burst lies before its trigger: a part of all points, or a number of them."""

    part: float | None = None
    points: int | None = None

    def of(self, total: int) -> int:
        """Points before the trigger of so many in all."""
        if self.points is not None:
            return self.points
        assert self.part is not None
        return min(round(self.part * total), max(total - 1, 0))


def before_text(text: str) -> Before:
    """Read ``30%`` or a number of points; an `argparse.ArgumentTypeError` if it is neither."""
    try:
        if text.endswith("%"):
            part = float(text[:-1]) / 100.0
            if 0.0 <= part <= 1.0:
                return Before(part=part)
        elif int(text) >= 0:
            return Before(points=int(text))
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is neither a part such as 30% nor a number of points")


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of a burst to those of ``record``."""
    burst = command.add_argument_group("burst", "Use a recorder of the board instead of reading over the line.")
    which = burst.add_mutually_exclusive_group()
    which.add_argument(
        "--fast", dest="recorder", action="store_const", const=_FAST, help="the recorder of the fast loop"
    )
    which.add_argument("--slow", dest="recorder", action="store_const", const=_SLOW, help="the one of the slow loop")
    which.add_argument("--recorder", type=_index, metavar="N", help="the recorder of that number")
    burst.add_argument(
        "--trigger", metavar="EXPR", help="such as 'axis1.i_q > 1.0', 'u_dc < 20', 'axis1.state rising FAULT'"
    )
    burst.add_argument("--level", action="store_true", help="trigger also when the condition holds from the beginning")
    burst.add_argument("--before", type=before_text, metavar="PART", help="points before the trigger (default: 50%%)")
    burst.add_argument("--points", type=_index, metavar="N", help="points in all (default: as many as fit)")
    burst.add_argument("--timeout", type=float, metavar="S", help="stop without a trigger after this time")


def _index(text: str) -> int:
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
    return int(text)


def record(context: Context) -> int:
    """Record a burst when an option of one is given; else rows over the line."""
    args = context.args
    options = (args.recorder, args.trigger, args.before, args.points, args.timeout)
    if all(option is None for option in options) and not args.level:
        return record_rows(context)
    return _record_burst(context)


def _record_burst(context: Context) -> int:
    """Set the recorder up, wait for the trigger, read the points and write the files."""
    args, session = context.args, context.session
    if args.duration is not None:
        raise UsageError("--duration is for rows over the line; say --points, or --timeout to stop without a trigger")
    if args.level and args.trigger is None:
        raise UsageError("--level says how a trigger fires; give one with --trigger")
    writers = [(writer_for(path), path) for path in map(Path, args.output)]
    names = opened(session.variables, args.names)
    channels = channels_of([(name, *chosen) for name, chosen in zip(names, select(context, names), strict=True)])
    trigger = None
    if args.trigger is not None:
        trigger = trigger_of(parse_expression(args.trigger), session.variables, context.catalogue, level=args.level)
    warn(context)
    recorder = session.client.recorder(args.recorder or 0)
    limits = _limits(recorder)
    divider = _divider(args.rate, limits)
    setup = _setup(tuple(channel.slot for channel in channels), args, divider, trigger, limits)
    points = recorder.configure(setup)
    with ProgressLine() as progress:
        triggered = _run(recorder, setup, points, limits.period_ns * divider, args.timeout, progress)
        memory = recorder.memory()
        client = session.client
        data = read_points(
            client.read_memory, client.read_limit & ~7, memory,
            lambda done, total: progress.bar("reading", done, total),
        )  # fmt: skip
    burst = burst_of(channels, data, limits.period_ns * divider, setup.before if triggered else 0)
    for write, path in writers:
        write(burst, path)
    print(_summary(burst, args.output, wanted=trigger is not None, triggered=triggered))
    return 0


def _limits(recorder: Recorder) -> Limits:
    try:
        return recorder.limits()
    except StatusError as error:
        raise RecorderError(f"the board has no recorder: {error.meaning}") from error


def _setup(
    slots: tuple[ScopeSlot, ...], args: argparse.Namespace, divider: int, trigger: Trigger | None, limits: Limits
) -> Setup:
    """Put together what is to be recorded."""
    setup = Setup(slots, args.points or 0, 0, divider, trigger)
    if trigger is None:
        return setup
    total = setup.points or limits.capacity(setup)
    before: Before = args.before or Before(part=0.5)
    if total is None and before.part is not None:
        raise UsageError("the board does not say how much memory its recorder has; give --points")
    return Setup(setup.slots, setup.points, before.of(total or 0), divider, trigger)


def _divider(rate: float | None, limits: Limits) -> int:
    """Find the divider for a rate [Hz].

    Raises
    ------
    UsageError
        If no whole divider gives the rate.
    """
    if rate is None:
        return 1
    if not limits.period_ns:
        raise UsageError("the board does not say how fast its recorder samples; leave --rate away")
    full = 1e9 / limits.period_ns
    divider = max(round(full / rate), 1)
    if abs(full / divider / rate - 1.0) > _RATE_TOLERANCE:
        near = sorted({max(int(full / rate), 1), int(full / rate) + 1})
        rates = " or ".join(f"{full / number:g}" for number in near)
        raise UsageError(f"the recorder samples at {full:g} Hz divided by a whole number: {rates} Hz, not {rate:g} Hz")
    return divider


def _run(
    recorder: Recorder, setup: Setup, points: int, period_ns: int, timeout: float | None, progress: ProgressLine
) -> bool:
    """Record until the trigger, Ctrl-C or the time-out; returns whether the trigger ended it.

    Without a trigger it ends when the memory is full.
    """
    span = points * period_ns * 1e-9
    limit = timeout
    if setup.trigger is None and period_ns:
        limit = span if timeout is None else min(span, timeout)
    start = time.monotonic()
    recorder.start()
    try:
        while limit is None or time.monotonic() - start < limit:
            if recorder.state() is not State.RUNNING:
                return setup.trigger is not None
            seconds = time.monotonic() - start
            progress.text(f"{'recording' if setup.trigger is None else 'waiting for the trigger'}, {seconds:.0f} s")
            time.sleep(_POLL if limit is None else min(_POLL, max(limit - seconds, 0.001)))
    except KeyboardInterrupt:
        pass
    if recorder.state() is not State.RUNNING:
        return setup.trigger is not None
    recorder.stop()
    due = time.monotonic() + span + _GRACE
    while recorder.state() is State.RUNNING:
        if time.monotonic() > due:
            raise RecorderError("the recorder of the board does not stop")
        time.sleep(_POLL)
    return False


def _summary(burst: Burst, files: list[str], *, wanted: bool, triggered: bool) -> str:
    span = ""
    if burst.timed and len(burst.times):
        span = f", {burst.times[0]:.6g} .. {burst.times[-1]:.6g} s"
    note = "" if triggered or not wanted else "; stopped before the trigger"
    return f"{len(burst.times)} points{span} in {', '.join(files)}{note}"
