"""Display of ``servo-tool scope``: telemetry and bursts on one timeline, in the rerun viewer or in a file.

The names of timeline and curves are those of the recordings of the twin. All rerun functions are called in a separate
thread, because some calls take half a second.
"""

from __future__ import annotations

import importlib.util
import shutil
import socket
import subprocess
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.output_file import write_file
from servo_msgs_py.recording_names import BURST, PLOT, TIMELINE
from servo_msgs_py.rerun_file import import_rerun
from servo_msgs_py.trace import with_unit

from servo_bridge.bursts.rerun_log import entity_of, send_curve
from servo_bridge.tool_values import UsageError

_WINDOW: Final = 15.0  # time span of the telemetry plots [s]
_WAITING: Final = 20  # queued calls before the caller blocks
_REACH: Final = 2.0  # timeout of the connection to a viewer [s]
_LOOPBACK: Final = "127.0.0.1"
_START: Final = 20.0  # timeout of the start of a viewer [s]
_POLL: Final = 0.2
_FLUSH: Final = 5.0  # timeout of the final flush [s]
_STALLED: Final = 10.0  # timeout of a call of the viewer [s]


class ViewLostError(RuntimeError):
    """The viewer or the file has not received all data."""


@dataclass(frozen=True)
class Curve:
    """Curve of a recording."""

    parts: tuple[str, ...]  # path of the entity
    title: str  # name with unit
    unit: str  # curves of the same unit share a plot


class ScopeView:
    """Open recording.

    Parameters
    ----------
    telemetry, bursts : sequence of Curve
        Curves.
    save : Path, optional
        File to write.
    connect : str, optional
        Address of a running viewer. Without `save` and `connect` a viewer is started.

    Raises
    ------
    RecordingError
        If rerun is not installed.
    UsageError
        If the file cannot be written, or no viewer can be reached.
    """

    def __init__(
        self,
        telemetry: Sequence[Curve],
        bursts: Sequence[Curve],
        *,
        save: Path | None = None,
        connect: str | None = None,
    ) -> None:
        self._rr = rr = import_rerun()
        sinks: list[Any] = []
        if save is not None:
            _check_file(save)
            sinks.append(rr.FileSink(str(save)))
        if connect is not None:
            _check_viewer(connect)
        elif save is None:
            connect = _viewer_started()
        if connect is not None:
            sinks.append(rr.GrpcSink(connect))
        self._telemetry, self._bursts = list(telemetry), list(bursts)
        self._stream = rr.RecordingStream("servo-tool scope", batcher_config=rr.ChunkBatcherConfig(flush_tick=0.2))
        self._stream.set_log_tick_enabled(False)
        self._stream.set_log_time_enabled(False)
        self._target = save or "the viewer"
        try:
            self._stream.set_sinks(*sinks, default_blueprint=_blueprint(telemetry, bursts))
        except RuntimeError as trouble:
            raise self._lost(trouble) from None
        self._writer = ThreadPoolExecutor(1, "rerun")
        self._waiting: deque[Future[None]] = deque()
        self._submit(self._titles)

    def __enter__(self) -> ScopeView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.shutdown(wait=error is None, cancel_futures=error is not None)
        try:
            for work in self._waiting if error is None else ():
                work.result()
            self._stream.flush(timeout_sec=_FLUSH)
        except (RuntimeError, ValueError) as trouble:
            if error is None:
                raise self._lost(trouble) from None
        finally:
            self._stream.disconnect()

    def telemetry(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Append rows: times [s] of shape (n,) and values of shape (n, curves)."""
        self._submit(lambda: self._send(self._telemetry, times, values))

    def burst(self, times: NDArray[np.float64], values: NDArray[np.float64], text: str) -> None:
        """Append a burst: times [s] (points,), values (points, curves); `text` is logged at its first point."""
        gap = np.full((1, values.shape[1]), np.nan)
        end = times[-1:] + (times[-1] - times[-2] if len(times) > 1 else 0.0)

        def send() -> None:
            self._send(self._bursts, np.append(times, end), np.vstack([values, gap]))
            self._stream.set_time(TIMELINE, duration=float(times[0]))
            self._stream.log("log/scope", self._rr.TextLog(text, level="INFO"))

        self._submit(send)

    def _lost(self, trouble: Exception) -> ViewLostError:
        return ViewLostError(f"{self._target} has not received all data: {str(trouble).splitlines()[0]}")

    # ---- writer thread
    def _titles(self) -> None:
        for curve in (*self._telemetry, *self._bursts):
            self._stream.log(entity_of(curve.parts), self._rr.SeriesLines(names=curve.title), static=True)

    def _send(self, curves: Sequence[Curve], times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        index = self._rr.TimeColumn(TIMELINE, duration=times)
        for curve, column in zip(curves, values.T, strict=True):
            send_curve(self._stream, entity_of(curve.parts), index, column)

    def _submit(self, work: Callable[[], None]) -> None:
        """Call a function in the thread; raises the errors of earlier calls."""
        self._waiting.append(self._writer.submit(work))
        while self._waiting and (len(self._waiting) > _WAITING or self._waiting[0].done()):
            try:
                self._waiting.popleft().result(_STALLED)
            except FutureTimeoutError:
                raise ViewLostError(f"the viewer has not received data for {_STALLED:g} s") from None
            except RuntimeError as trouble:
                raise self._lost(trouble) from None


def _check_file(path: Path) -> None:
    """Raise if the file cannot be written; rerun would only log it."""
    if path.suffix.lower() != ".rrd":
        raise UsageError(f"{path}: the name of a rerun recording must end with .rrd")
    write_file(path, b"")


def _check_viewer(url: str) -> None:
    """Raise if no viewer listens; rerun would wait for it at the end."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if host is None or port is None or parts.scheme not in ("rerun", "rerun+http", "rerun+https"):
        raise UsageError(f"{url!r} is not an address of a rerun viewer; write e.g. rerun+http://127.0.0.1:9876/proxy")
    try:
        socket.create_connection((host, port), _REACH).close()
    except OSError as error:
        raise UsageError(f"no rerun viewer at {url} ({error.strerror or error}); start it first") from None


def _viewer_started() -> str:
    """Start a viewer that listens on the loopback interface only and survives this program; returns its address."""
    spec = importlib.util.find_spec("rerun_cli")  # path of the program
    folders = [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
    program = next((str(path) for folder in folders if (path := folder / "rerun").is_file()), None)
    program = program or shutil.which("rerun")
    if program is None:
        raise UsageError("the program rerun is missing; install it with pip install 'rerun-sdk==0.41.*'")
    with socket.socket() as probe:
        probe.bind((_LOOPBACK, 0))
        port = probe.getsockname()[1]
    command = [program, "--bind", _LOOPBACK, "--port", str(port), "--hide-welcome-screen", "--expect-data-soon"]
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    end = time.monotonic() + _START
    while True:
        with socket.socket() as probe:
            answers = probe.connect_ex((_LOOPBACK, port)) == 0
        time.sleep(_POLL)
        if viewer.poll() is not None:
            raise UsageError(
                f"the rerun viewer ended with status {viewer.returncode} (no display?); use --save FILE.rrd or"
                " --connect URL instead"
            )
        if answers:
            return f"rerun+http://{_LOOPBACK}:{port}/proxy"
        if time.monotonic() > end:
            viewer.terminate()
            raise UsageError(f"the rerun viewer did not open within {_START:g} s")


def _blueprint(telemetry: Sequence[Curve], bursts: Sequence[Curve]) -> Any:
    """Telemetry with a plot per unit, next to the bursts and the log."""
    import rerun.blueprint as rrb

    relative = rrb.TimeRangeBoundary.cursor_relative
    start, end = relative(seconds=-_WINDOW), relative(seconds=0.0)
    live = {
        "axis_x": rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end)),
        "time_ranges": [rrb.VisibleTimeRange(TIMELINE, start=start, end=end)],
    }

    def plots(name: str, origin: str, curves: Sequence[Curve], **options: Any) -> Any:
        units = dict.fromkeys(curve.unit for curve in curves)
        return rrb.Vertical(
            *(
                rrb.TimeSeriesView(
                    name=with_unit(name, unit),
                    origin=origin,
                    contents=[f"+ /{entity_of(curve.parts).strip('/')}" for curve in curves if curve.unit == unit],
                    plot_legend=rrb.Corner2D.LeftTop,
                    **options,
                )
                for unit in units
            ),
            name=name,
        )

    log = rrb.TextLogView(name="log", origin="/log")
    return rrb.Blueprint(
        rrb.Horizontal(
            plots("telemetry", f"/{PLOT}", telemetry, **live),
            rrb.Vertical(plots("bursts", f"/{BURST}", bursts), log, row_shares=[5, 1]),
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )
