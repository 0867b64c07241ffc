"""Link to one board: a thread that owns the port, reads telemetry continuously and executes jobs.

Jobs are queued and return futures; samples and changes of state are reported by callbacks in the thread of the link.
The loss of the link fails all waiting jobs; it is re-established automatically. Commands are never repeated by that,
and a board that does not match the catalogue receives no command except a stop.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any, Final, TypeVar

from servo_msgs_py.board_parameters import parameter_names
from servo_msgs_py.catalogue import Catalogue, Value, Variable
from servo_msgs_py.topics import COMMAND_VARIABLES

from servo_bridge.freemaster.client import BoardInfo, Client
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    DamagedAnswerError,
    FreemasterError,
    TransportError,
    WrongProtocolError,
)
from servo_bridge.freemaster.line import Line
from servo_bridge.wire.board_clock import TickExtender
from servo_bridge.wire.boot_token import agreed_boot_token
from servo_bridge.wire.keep_alive import KEEP_ALIVE_PERIOD, KeepAlive, kept_alive
from servo_bridge.wire.link_config import TICK, FinalWrite, LinkConfig, Port
from servo_bridge.wire.link_queue import Job, JobQueue, LinkBusyError, LinkDownError
from servo_bridge.wire.link_state import LinkState, LinkStatus, status_of
from servo_bridge.wire.link_statistics import LinkStatistics, StatisticsCollector
from servo_bridge.wire.restoration import await_restored
from servo_bridge.wire.scope import Sample, ScopeLayout
from servo_bridge.wire.scope_reader import BoardResetError, ScopeReader
from servo_bridge.wire.serial_port import LowLatency, SerialPort
from servo_bridge.wire.session import Session, connect
from servo_bridge.wire.stop_at_connection import stopped_at_connection

__all__ = [
    "FinalWrite",
    "Link",
    "LinkBusyError",
    "LinkConfig",
    "LinkDownError",
    "LinkState",
    "LinkStatus",
    "Port",
    "Sample",
]

T = TypeVar("T")

_LOG: Final = logging.getLogger(__name__)
_MAX_DAMAGED: Final = 10
_NEXT_WRITE: Final = 0.4
"""Pause after a sample that confirms a write, as a fraction of its round trip: lets the owner queue its next write
before the next sample is requested."""
_PAUSE_MIN: Final = 0.01
"""Pause before the next attempt of a keep-alive that is withheld [s]."""


class _StopError(Exception):
    """The owner has requested the end of the thread."""


class Link:
    """Maintains the connection to one board.

    Parameters
    ----------
    config : LinkConfig
        Port and settings.
    catalogue : Catalogue
        Meaning of the variables.
    on_sample : callable
        Receives every sample, in the thread of the link; must be fast.
    on_state : callable
        Receives every change of the state, in the thread of the link.
    hang : callable
        Text if the owner, which sends the commands, hangs; else empty. Called in the thread of the link. Keep-alives
        are withheld then, so that the board stops its axes.
    open_port : callable
        Opens a port from URL and baud rate.

    Raises
    ------
    ValueError
        If a telemetry variable is unknown or has an unsupported size.
    """

    def __init__(
        self,
        config: LinkConfig,
        catalogue: Catalogue,
        *,
        on_sample: Callable[[Sample], None],
        on_state: Callable[[LinkStatus], None],
        hang: Callable[[], str] = lambda: "",
        open_port: Callable[[str, int], Port] = SerialPort,
    ) -> None:
        self._config = config
        self._catalogue = catalogue
        self._on_sample = on_sample
        self._on_state = on_state
        self._hang = hang
        self._hung = False
        self._keep_alive: KeepAlive | None = None
        self._keep_alive_period = KEEP_ALIVE_PERIOD
        self._open_port = open_port
        names = tuple(dict.fromkeys((TICK, *config.telemetry)))
        unknown = [name for name in names if name not in catalogue.variables]
        if unknown:
            raise ValueError(f"the catalogue has no variable {', '.join(unknown)}")
        self.layout = ScopeLayout([catalogue.variables[name] for name in names])
        self._queue = JobQueue(config.queue_limit)
        self._statistics = StatisticsCollector()
        self._extender = TickExtender()
        self._token: int | None = None  # boot token of the previous connection; None: the next one begins an epoch
        self._status = LinkStatus(LinkState.DISCONNECTED, "not started")
        self._session: Session | None = None
        self._low_latency = LowLatency(None, "not open")
        self._stop = threading.Event()
        self._final_writes: Sequence[FinalWrite] = ()
        self._final_done = False
        self._connected_once = False
        self._thread = threading.Thread(target=self._run, name="servo link", daemon=True)

    # ---- interface, any thread --------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread; it connects repeatedly until `close`."""
        self._thread.start()

    def close(self, final_writes: Sequence[FinalWrite] = (), timeout: float = 3.0) -> bool:
        """Stop the thread and close the port.

        Parameters
        ----------
        final_writes : sequence of (str, sequence of float)
            Written last, in this order, if the link is up; waiting jobs are discarded.
        timeout : float
            Longest wait [s]. The thread needs at most three timeouts of a silent board, or the 5 s of the operating
            system to open a network port; it is a daemon thread and does not keep the process alive.

        Returns
        -------
        bool
            Whether the board has acknowledged all final writes.
        """
        self._final_writes = tuple(final_writes)
        self._stop.set()
        self._queue.wake()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout)
        return self._final_done

    @property
    def status(self) -> LinkStatus:
        """State with reason and remedy."""
        return self._status

    @property
    def board(self) -> BoardInfo | None:
        """Description of the connected board."""
        session = self._session
        return None if session is None else session.info

    @property
    def low_latency(self) -> LowLatency:
        """Whether the adapter passes bytes on immediately."""
        return self._low_latency

    def statistics(self) -> LinkStatistics:
        """Present figures."""
        return self._statistics.report(time.monotonic_ns(), len(self._queue))

    def write(self, name: str, values: Sequence[float], *, first: int = 0, urgent: bool = False) -> Future[None]:
        """Write neighbouring elements of a variable [SI].

        Parameters
        ----------
        name : str
            Name of the variable.
        values : sequence of float
            One per element.
        first : int
            Index of the first element.
        urgent : bool
            Executed before all other waiting jobs.

        Returns
        -------
        Future
            Done when the board has acknowledged. Fails with `LinkDownError`, `LinkBusyError` or `StatusError`
            (`OutOfRangeError` for a value that the board refuses).

        Raises
        ------
        ValueError
            If the variable is unknown or read-only, or a value is out of limits; nothing is sent.
        """
        variable = self._known(name)
        raw = [variable.to_raw(value) for value in values]
        return self.write_raw(name, raw, first=first, urgent=urgent)

    def write_raw(self, name: str, raw: Sequence[int], *, first: int = 0, urgent: bool = False) -> Future[None]:
        """Write neighbouring elements of a variable as firmware integers; see `write`."""
        variable = self._known(name)
        offset, data = variable.encode_part(raw, first)
        command = name in COMMAND_VARIABLES
        lengthy = command or name in parameter_names()  # the board counts and executes every received write

        def run(session: Session) -> None:
            session.write_contract(variable, data, offset, lengthy=lengthy)
            self._statistics.wrote()
            if command and self._keep_alive is not None:
                self._keep_alive.commanded()

        job = Job(run, write=True)
        self._queue.put(job, urgent=urgent)
        return job.done

    def read(self, name: str) -> Future[Value]:
        """Read a variable [SI]; the future fails as in `write`."""
        self._known(name)
        return self.call(lambda session: session.read(session.variables[name]))

    def call(self, function: Callable[[Session], T]) -> Future[T]:
        """Call a function with the session of the board between two samples; it should take few exchanges.

        Its exceptions fail the future; only errors of the line end the connection.
        """
        job = Job(function)
        self._queue.put(job)
        return job.done

    def set_keep_alive_period(self, period: float) -> None:
        """Set the longest time without a command or a keep-alive [s]."""
        self._keep_alive_period = period
        keep_alive = self._keep_alive
        if keep_alive is not None:
            keep_alive.period = period

    # ---- thread of the link -----------------------------------------------------------------------------------

    def _known(self, name: str) -> Variable:
        try:
            return self._catalogue[name]
        except KeyError as error:
            raise ValueError(error.args[0]) from None

    def _run(self) -> None:
        pause = self._config.backoff_min
        self._set_status(LinkStatus(LinkState.CONNECTING, f"connecting to {self._config.url}"))
        while not self._stop.is_set():
            self._connected_once = False
            try:
                self._hold_port()
            except _StopError:
                break
            except Exception as error:  # includes internal errors, which are reported; the thread continues
                self._lost(error)
            pause = self._config.backoff_min if self._connected_once else min(2 * pause, self._config.backoff_max)
            self._stop.wait(pause)
        self._queue.close("the link was closed")
        self._set_status(LinkStatus(LinkState.DISCONNECTED, "closed"))

    def _hold_port(self) -> None:
        """Open the port and communicate until it is lost; after a reset of the board, connect again at once."""
        port = self._open_port(self._config.url, self._config.baud)
        self._low_latency = port.low_latency
        try:
            while True:
                try:
                    self._talk(port)
                except BoardResetError as error:
                    if self._session is None:
                        raise
                    self._statistics.reset_seen()
                    self._token = None
                    self._lost(error)
        finally:
            self._session = None
            port.close()

    def _talk(self, port: Port) -> None:
        line = Line(
            port,
            baud=self._config.baud,
            latency=self._config.latency,
            before_request=self._check_stop,
            statistics=self._statistics.counters,
        )
        client = Client(line)
        client.ask_password = lambda: self._config.password
        with stopped_at_connection(client, self._catalogue):
            session = connect(client, self._catalogue)
            if session.mismatch is not None:
                raise session.mismatch
            await_restored(session)
            reader = self._reader_of(session)
            first = reader.first()
        line.before_request = None  # the final writes must not be interrupted
        self._session = session
        self._connected_once = True
        self._statistics.connected()
        self._queue.open()
        name = session.info.name or "board"
        self._set_status(LinkStatus(LinkState.CONNECTED, f"connected to {name} at {self._config.url}"))
        self._deliver(first)
        try:
            with kept_alive(client, self._catalogue, self._withheld, self._statistics.fed) as self._keep_alive:
                self.set_keep_alive_period(self._keep_alive_period)
                self._loop(session, reader, self._keep_alive)
        finally:
            self._keep_alive = None
            line.work_off()
        self._write_last(session)
        raise _StopError

    def _reader_of(self, session: Session) -> ScopeReader:
        """Reader of a new connection; registers a reset of the board since the previous one."""
        token, before = agreed_boot_token(session), self._token
        if before is not None and token != before:
            self._extender.restart()
            self._statistics.reset_seen()
        self._token = token
        return ScopeReader(session, self.layout, self._extender, token, self._statistics.clocks_disagree)

    def _withheld(self) -> bool:
        """Whether keep-alives are withheld because the owner hangs."""
        reason = self._hang()
        if reason:
            self._statistics.withheld(reason)
            if not self._hung:
                _LOG.error("no more keep-alives: %s; the board stops its axes", reason)
        self._hung = bool(reason)
        return self._hung

    def _loop(self, session: Session, reader: ScopeReader, keep_alive: KeepAlive) -> None:
        """Alternate between one job and one sample until the owner requests a stop.

        A sample is delivered to the owner while the next request is being transmitted; after a sample that confirms a
        write the loop pauses, because the owner may send the next write.
        """
        line = session.client.line
        period = round(1e9 / self._config.rate) if self._config.rate > 0.0 else 0
        timeout_ns = round(self._config.lost_after * self._config.latency * 1e9)
        due = time.monotonic_ns() + period
        timeouts = damaged = 0
        silent_ns = 0
        wrote, grace = False, 0.0
        while not self._stop.is_set():
            keep_alive()
            pause = max(grace, min((due - time.monotonic_ns()) * 1e-9, max(keep_alive.remaining, _PAUSE_MIN)))
            grace = 0.0
            if pause > 0.0:
                line.work_off()
            job = self._queue.take(pause)
            if job is not None:
                self._execute(job, session)
                wrote |= job.write
            if time.monotonic_ns() < due:
                continue
            due = max(due + period, time.monotonic_ns())
            try:
                requested_ns = time.monotonic_ns()
                sample = reader.next()
            except AnswerTimeoutError:
                silent_ns = silent_ns if timeouts else requested_ns
                timeouts += 1
                if timeouts >= self._config.lost_after and time.monotonic_ns() - silent_ns >= timeout_ns:
                    raise
                continue
            except DamagedAnswerError:
                damaged += 1
                if damaged >= _MAX_DAMAGED:
                    raise
                continue
            timeouts = damaged = 0
            if sample is not None:
                line.meanwhile = partial(self._deliver, sample)
                grace = _NEXT_WRITE * (sample.response_ns - sample.request_ns) * 1e-9 if wrote else 0.0
                wrote = False

    def _execute(self, job: Job, session: Session) -> None:
        try:
            job.execute(session)
        except (AnswerTimeoutError, DamagedAnswerError, TransportError, WrongProtocolError):
            raise  # requests have been repeated: the link is lost
        except Exception:
            return  # reported by the future; the line works

    def _write_last(self, session: Session) -> None:
        self._queue.close("the link was closed")
        for name, values in self._final_writes:
            session.write(session.variables[name], values)
        self._final_done = True

    def _check_stop(self) -> None:
        if self._stop.is_set():
            raise _StopError

    def _lost(self, error: Exception) -> None:
        """Report the reason and fail the waiting jobs."""
        status = status_of(error, self._config.url, self._config.baud, connected=self._connected_once)
        if not isinstance(error, FreemasterError):
            _LOG.error("unexpected error in the thread of the link", exc_info=error)
        self._session = None
        self._queue.close(status.reason)
        self._set_status(status)

    def _set_status(self, status: LinkStatus) -> None:
        if status == self._status:
            return
        self._status = status
        self._call(self._on_state, status)

    def _deliver(self, sample: Sample) -> None:
        self._statistics.sampled(sample.request_ns, sample.response_ns)
        self._call(self._on_sample, sample)

    @staticmethod
    def _call(function: Callable[[Any], None], argument: object) -> None:
        """Call a callback; log any exception and continue."""
        try:
            function(argument)
        except Exception:
            _LOG.exception("a callback of the link failed")
