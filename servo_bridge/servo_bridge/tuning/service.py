"""The service ``tune`` and the topic ``tuning``: another configuration for the axes of a board that runs.

A thread of its own waits for the tuning code and for the link. The link gets one exchange at a time, between two
samples of the telemetry and behind every set-point; ``config.take`` goes the way of a command, so that its tick is
known and a twin can repeat it there.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent import futures
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Final

from rclpy.node import Node
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import BlockRefusedError, take_result
from servo_msgs_py.catalogue import AXES, numbers
from servo_msgs_py.runtime.qos import latched_qos
from servo_msgs_py.tuning.errors import ConfigError
from std_msgs.msg import String
from std_srvs.srv import SetBool

from servo_bridge.deferred_service import DeferredService, Outcome
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.tuning.block_session import BlockSession
from servo_bridge.tuning.plan import Plan, read_blocks
from servo_bridge.tuning.process import TuningProcess
from servo_bridge.wire.link_queue import LinkDownError
from servo_bridge.wire.session import Call
from servo_msgs_py import topics

_TIMEOUTS: Final = ("param.host_timeout", "param.command_timeout")
_TIMEOUT: Final = 10.0
"""Longest wait for one exchange [s]; the link itself answers sooner, or is lost."""


class _LinkMemory:
    """A `servo_msgs_py.axis_config_transfer.BlockMemory`: every word by a job of the link of its own."""

    def __init__(self, call: Call) -> None:
        self._call = call

    def read_words(self, name: str) -> list[int]:
        return self._call(lambda session: BlockSession(session).read_words(name)).result(_TIMEOUT)

    def write_words(self, name: str, words: Sequence[int]) -> bool:
        return self._call(lambda session: BlockSession(session).write_words(name, words)).result(_TIMEOUT)

    def read(self, name: str) -> float:
        return numbers(self._call(lambda session: session.read(session.variables[name])).result(_TIMEOUT))[0]


class TuningService:
    """Tunes when it is asked to, and publishes what the board has.

    Parameters
    ----------
    node : Node
        Owner of service and topic.
    path : str
        The file that the service sends.
    call : Call
        Way to the board.
    post : callable
        Runs a function in the thread of the node.
    take : callable
        Starts a write of ``config.take`` on the way of the commands, in the thread of the node; the future holds the
        tick at which it took effect.
    taken : callable
        Called in the thread of the node when the board has got other blocks.
    say, warn : callable
        Get a sentence for the log, in the thread of the node.
    """

    def __init__(
        self,
        node: Node,
        path: str,
        call: Call,
        post: Callable[[Callable[[], None]], None],
        *,
        take: Callable[[CommandWrite], Future[int]],
        taken: Callable[[], None],
        say: Callable[[str], None],
        warn: Callable[[str], None],
    ) -> None:
        self.path = path  # another one counts from the next call on
        self._memory = _LinkMemory(call)
        self._post = post
        self._take, self._taken = take, taken
        self._say, self._warn = say, warn
        self._process = TuningProcess()
        self._busy = False
        self._published: str | None = None  # since the link is up
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._publisher = node.create_publisher(String, topics.TUNING, latched_qos())
        self._service = DeferredService(node, SetBool, topics.TUNE, lambda request: self._asked(request.data))
        self._thread = threading.Thread(target=self._run, name="servo tuning", daemon=True)
        self._thread.start()

    # ---- thread of the node
    def connected(self) -> None:
        """The link is up: read the board's configuration and publish it, for a twin may have forgotten it."""
        self._published = None
        self._jobs.put(self._refresh)

    def close(self) -> None:
        """Give up what is being done; the thread ends by itself."""
        self._process.close()
        self._jobs.put(None)

    def _asked(self, send: bool) -> Future[Outcome]:
        answer: Future[Outcome] = Future()
        if not self.path:
            answer.set_result((False, "the parameter tuning names no file; set it to the path of a TOML file first"))
        elif self._busy:
            answer.set_result((False, "the board is being tuned already; call tune again when that is answered"))
        else:
            self._busy = True
            self._jobs.put(partial(self._tune, Path(self.path), send, answer))
        return answer

    def _answer(self, answer: Future[Outcome], outcome: Outcome) -> None:
        self._busy = False
        success, message = outcome
        (self._say if success else self._warn)(f"tune: {message.splitlines()[-1]}")
        answer.set_result(outcome)

    def _publish(self, text: str) -> None:
        if text != self._published:
            self._published = text
            self._publisher.publish(String(data=text))

    # ---- own thread
    def _run(self) -> None:
        while True:
            job = self._jobs.get()
            if job is None:
                return
            job()

    def _tune(self, path: Path, send: bool, answer: Future[Outcome]) -> None:
        lines: list[str] = []
        success = unsure = False
        try:
            plan = self._plan(path, lines)
            if send and plan.axes:
                plan.send(self._memory)
                unsure = True
                lines.append(f"{plan.names} taken at tick {self._bring_into_force(plan)}")
            elif plan.axes:
                lines.append(f"the board would take another configuration for {plan.names}")
            success = True
        except BlockRefusedError as error:
            unsure = False
            lines.append(str(error))
        except ConfigError as error:
            lines.append(f"{path}: {error}")
        except Exception as error:  # also one of our own making: the service has to answer
            lines.append(_text(error))
        self._post(partial(self._answer, answer, (success, "\n".join(lines))))
        if unsure:
            self._post(self._taken)
            self._refresh()

    def _plan(self, path: Path, lines: list[str]) -> Plan:
        """What changes; with the warnings and a table of it at the end of `lines`."""
        old = read_blocks(self._memory)
        blocks, warnings = self._process.computed(path)
        lines += [f"{path}: warning: {warning}" for axis in range(AXES) for warning in warnings[axis]]
        plan = Plan(old, dict(enumerate(blocks)))
        if plan.axes:
            lines += plan.table()
        else:
            lines.append(f"the board has the configuration of {path}; nothing changes")
        return plan

    def _bring_into_force(self, plan: Plan) -> int:
        """Have the board take what it was sent; returns the tick.

        Raises
        ------
        BlockRefusedError
            If it refuses.
        ConnectionError
            If it does not say what has become of it.
        """
        table = AxisConfigTable.load()
        members = tuple(word for _, new in plan.changes.values() for word in table.words(new))
        write = CommandWrite("config.take", 0, (sum(1 << axis for axis in plan.axes),), members)
        begun: Future[Future[int]] = Future()
        self._post(lambda: begun.set_result(self._take(write)))
        try:
            return begun.result(_TIMEOUT).result(_TIMEOUT)
        except (ConnectionError, futures.TimeoutError):
            # A request that was repeated is refused though the first one has been obeyed.
            in_force = self._memory.read_words("config.checksum")
            if all(in_force[axis] == checksum for axis, checksum in plan.checksums().items()):
                return self._memory.read_words("config.taken_tick")[0]
            take_result(self._memory)
            raise

    def _refresh(self) -> None:
        """Read what the board has and publish it; an empty text when that cannot be read."""
        try:
            blocks = list(read_blocks(self._memory).values())
            host, command = (self._memory.read(name) for name in _TIMEOUTS)
            text = self._process.file_of(blocks, (host, command))
        except LinkDownError:
            return  # told elsewhere, and read again when it is back
        except Exception as error:  # also one of our own making: the thread goes on
            self._post(partial(self._warn, f"the configuration of the board is not known: {_text(error)}"))
            text = ""
        self._post(partial(self._publish, text))


def _text(error: Exception) -> str:
    """An error in one line."""
    return str(error) or (
        "the board does not answer" if isinstance(error, futures.TimeoutError) else type(error).__name__
    )
