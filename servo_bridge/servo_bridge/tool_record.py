"""``servo-tool record`` with the recorder of the board: a burst at the rate of the control loops, around a trigger."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from servo_msgs_py.runtime.program import deferred
from servo_msgs_py.trace import Trace

from servo_bridge.bursts import request as burst_request
from servo_bridge.bursts.files import writer_for
from servo_bridge.bursts.recording import BurstRecording, Phase
from servo_bridge.bursts.request import BurstRequest
from servo_bridge.tool_commands import record as record_rows
from servo_bridge.tool_commands import warn
from servo_bridge.tool_progress import progress_bar, show
from servo_bridge.tool_values import UsageError
from servo_bridge.wire.session import Session
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the burst options of ``record``."""
    burst_request.add_options(command)
    command.add_argument(
        "--timeout", type=argument.positive, metavar="S", help="stop a burst without a trigger after this time"
    )


def _is_burst(args: argparse.Namespace) -> bool:
    options = (args.recorder, args.trigger, args.before, args.points, args.timeout)
    return args.level or any(option is not None for option in options)


def check(args: argparse.Namespace) -> None:
    """Check the options of rows or of a burst."""
    if not _is_burst(args):
        if len(args.output) > 1:
            raise UsageError("without burst options only one output file is possible")
    elif args.duration is not None:
        raise UsageError("--duration is not for bursts; use --points, or --timeout to stop without a trigger")
    else:
        BurstRequest.of(args)
        for path in args.output:
            writer_for(path)


def record(context: Context) -> int:
    """Record a burst if a burst option is given; else rows over the line."""
    args = context.args
    if not _is_burst(args):
        return record_rows(context)
    writers = [(writer_for(path), path) for path in args.output]
    recording = BurstRecording(BurstRequest.of(args), context.catalogue)
    warn(context)
    burst = run(recording, context.session, args.timeout)
    for write, path in writers:
        write(burst, path)
    print(_summary(burst, args.output, recording, triggered=args.trigger is not None))
    return 0


def run(recording: BurstRecording, session: Session, timeout: float | None = None) -> Trace:
    """Record a burst until its trigger, a signal or the timeout [s], with a progress line."""
    start = time.monotonic()
    with progress_bar() as bar, deferred() as stop:
        while (burst := recording.step(session)) is None:
            seconds = time.monotonic() - start
            if recording.phase is Phase.READING:
                show(bar, "reading ", recording.read, recording.size)
            else:
                show(bar, f"{recording.phase.value}, {seconds:.0f} s")
            if stop.requested or (timeout is not None and seconds >= timeout):
                recording.stop()
            time.sleep(recording.pause)
    return burst


def _summary(burst: Trace, files: list[Path], recording: BurstRecording, *, triggered: bool) -> str:
    span = ""
    if burst.step and len(burst):
        span = f", {burst.time[0]:.6g} .. {burst.time[-1]:.6g} s"
    note = "; stopped before the trigger" if triggered and not recording.triggered else ""
    return f"{len(burst)} points{span} in {', '.join(map(str, files))}{note}"
