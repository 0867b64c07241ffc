"""``servo-tool scope``: telemetry and repeated bursts, live in the rerun viewer or in a file."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Final, NoReturn

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name, numbers
from servo_msgs_py.recording_names import burst_parts, telemetry_parts
from servo_msgs_py.runtime.program import deferred
from servo_msgs_py.trace import Trace

from servo_bridge.bursts import request as burst_request
from servo_bridge.bursts.burst import Channel, channels_of
from servo_bridge.bursts.recording import BurstRecording, Phase
from servo_bridge.bursts.request import TICK, BurstRequest
from servo_bridge.bursts.timeline import BoardTime, HostTime, Timeline
from servo_bridge.freemaster.errors import FreemasterError
from servo_bridge.sampler import Sampler
from servo_bridge.scope_view import Curve, ScopeView, ViewLostError
from servo_bridge.tool_commands import warn
from servo_bridge.tool_progress import progress_bar, show
from servo_bridge.tool_values import UsageError, lookup, opened
from servo_bridge.wire.session import Session
from servo_msgs_py import argument

if TYPE_CHECKING:
    from tqdm import tqdm

    from servo_bridge.tool_commands import Context

_TELEMETRY: Final = (*(f"{axis_name(k)}.{name}" for k in range(AXES) for name in ("position", "speed", "i_q")), "u_dc")
_SHOW: Final = 0.2
"""Shortest period of updates of the viewer [s]."""


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of ``scope`` to those of a burst."""
    burst_request.add_options(command)
    command.add_argument(
        "--rate", type=argument.positive, metavar="HZ", help="points of a burst per second (default: all)"
    )
    command.add_argument(
        "--telemetry",
        nargs="+",
        metavar="NAME",
        help="variables read continuously (default: position, speed and i_q of both axes and u_dc; for other "
        "boards the variables of the burst)",
    )
    command.add_argument(
        "--count", type=argument.count, metavar="N", help="end after this number of bursts (default: at Ctrl-C)"
    )
    command.add_argument(
        "--save", type=argument.output_file, metavar="FILE.rrd", help="write a recording instead of opening a viewer"
    )
    command.add_argument(
        "--connect", metavar="URL", help="use a running viewer, such as rerun+http://127.0.0.1:9876/proxy"
    )


def scope(context: Context) -> int:
    """Record telemetry and bursts until Ctrl-C or the last burst."""
    args, session = context.args, context.session
    request = BurstRequest.of(args)
    ours = session.mismatch is None
    names = opened(session.variables, args.telemetry or (_TELEMETRY if ours else args.names))
    telemetry = _Telemetry(session, names, ticks=ours)
    run = _Run(context, request.with_tick() if ours else request, telemetry)
    warn(context)
    run.begin()  # refusals of the board come before the viewer is opened
    curves = [_curve(telemetry_parts(channel.name), channel) for channel in telemetry.channels]
    bursts = [_curve(burst_parts(channel.name), channel) for channel in run.shown]
    try:
        with ScopeView(curves, bursts, save=args.save, connect=args.connect) as view:
            run.until_ended(view, args.count)
    except ViewLostError as error:
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1
    note = f" in {args.save}" if args.save else ""
    print(f"{run.bursts} burst{'' if run.bursts == 1 else 's'} and {telemetry.rows} rows of telemetry{note}")
    return 0


def _curve(parts: tuple[str, ...], channel: Channel) -> Curve:
    return Curve(parts, channel.head, channel.variable.unit)


class _Telemetry:
    """Reads and collects rows of variables."""

    def __init__(self, session: Session, names: Sequence[str], *, ticks: bool) -> None:
        self._selection = [lookup(session.variables, name) for name in names]
        self.channels = channels_of([(name, *found) for name, found in zip(names, self._selection, strict=True)])
        """Columns of a row."""
        variables = [variable for variable, _ in self._selection]
        self._ticks = ticks
        self._sampler = Sampler(session, [session.variables[TICK], *variables] if ticks else variables)
        if ticks and not self._sampler.simultaneous:
            raise UsageError(
                f"the board cannot read {len(names)} variables simultaneously; select fewer with --telemetry"
            )
        self.timeline: Timeline = BoardTime() if ticks else HostTime()  # timeline of rows and bursts
        self.rows = 0  # read so far
        self._times: list[float] = []
        self._values: list[list[float]] = []
        self._shown = time.monotonic()

    def read(self) -> None:
        """Read a row."""
        reading = self._sampler.read()
        values = list(reading.values)
        tick = int(numbers(values.pop(0))[0]) if self._ticks else None
        moment = self.timeline.row(reading.time_ns, tick)
        if moment is None:
            return  # same sample as before
        cells: list[float] = []
        for (_, element), value in zip(self._selection, values, strict=True):
            found = numbers(value)
            cells += found if element is None else [found[element]]
        self._times.append(moment)
        self._values.append(cells)
        self.rows += 1

    def show(self, view: ScopeView, *, all_of_it: bool = False) -> None:
        """Pass the collected rows to the viewer if an update is due."""
        now = time.monotonic()
        if self._times and (all_of_it or now >= self._shown + _SHOW):
            view.telemetry(np.array(self._times), np.array(self._values, np.float64))
            self._times, self._values, self._shown = [], [], now


class _Run:
    """Sequence of bursts."""

    def __init__(self, context: Context, request: BurstRequest, telemetry: _Telemetry) -> None:
        self._session, self._catalogue = context.session, context.catalogue
        self._request = request
        self._hidden = () if TICK in context.args.names else (TICK,)  # it gives the points their times
        self._telemetry = telemetry
        self._recording = BurstRecording(request, self._catalogue)
        self._stopped_ns: int | None = None
        self.bursts = 0  # recorded so far

    def begin(self) -> None:
        """Set up the recorder; raises the errors of `BurstRecording.step`."""
        self._recording.step(self._session)
        if not self._recording.timed:
            self._recording.abandon()
            raise UsageError(
                "the board does not report the sampling rate of its recorder, so bursts have no times; use "
                "`servo-tool record`"
            )

    @property
    def shown(self) -> list[Channel]:
        """Channels of a burst that are shown."""
        return [channel for channel in self._recording.channels if channel.name not in self._hidden]

    def until_ended(self, view: ScopeView, count: int | None) -> None:
        """Continue until a signal, or for `count` bursts."""
        with progress_bar() as bar, deferred() as stop:
            try:
                self._telemetry.read()  # origin of the timeline
                self._again()  # restart: the viewer may have taken long to open
                due = time.monotonic()
                while not stop.requested:
                    self._telemetry.read()
                    self._telemetry.show(view)
                    if time.monotonic() >= due:
                        self._step(view, bar)
                        if self.bursts == count:
                            break
                        due = time.monotonic() + self._recording.pause
            finally:
                with suppress(FreemasterError):
                    self._recording.abandon()
                self._telemetry.show(view, all_of_it=True)

    def _again(self) -> None:
        """Start the next burst."""
        self._recording.abandon()
        self._recording, self._stopped_ns = BurstRecording(self._request, self._catalogue), None
        self.begin()

    def _step(self, view: ScopeView, bar: tqdm[NoReturn]) -> None:
        recording = self._recording
        burst = recording.step(self._session)
        if recording.phase is Phase.READING and self._stopped_ns is None:
            self._stopped_ns = time.monotonic_ns()
        if burst is not None:
            bar.clear()
            self._show(view, burst)
            self._again()
        elif recording.phase is Phase.READING:
            show(bar, f"burst {self.bursts + 1}: reading ", recording.read, recording.size)
        else:
            show(bar, f"burst {self.bursts + 1}: {recording.phase.value}, {self._telemetry.rows} rows of telemetry")

    def _show(self, view: ScopeView, burst: Trace) -> None:
        assert self._stopped_ns is not None
        self.bursts += 1
        times = self._telemetry.timeline.burst(burst, self._stopped_ns)
        at = times[0] - burst.time[0]
        text = f"burst {self.bursts} at {at:.6f} s: {self._recording.text}"
        view.burst(times, burst.table(name for name in burst.columns if name not in self._hidden), text)
        print(text, flush=True)
