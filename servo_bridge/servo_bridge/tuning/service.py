"""The service ``tune`` and the topic ``tuning``: change of the configuration of a running board.

The thread of the requests waits for the tuning code and the link. ``config.take`` is sent by the dispatcher like a
command, so that its tick is known and a twin can repeat it at this tick.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent import futures
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from rclpy.node import Node
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import BlockRefusedError, take_result
from servo_msgs_py.blocks_message import blocks_message
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.runtime.qos import latched_qos
from servo_tuning.errors import ConfigError
from std_msgs.msg import Int64MultiArray
from std_srvs.srv import SetBool

from servo_bridge.board_context import BoardContext
from servo_bridge.board_requests import TIMEOUT, BoardRequests, error_text
from servo_bridge.deferred_service import DeferredService
from servo_bridge.outcome import Outcome, answered
from servo_bridge.part import Part
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.tuning.plan import Block, Plan, read_blocks
from servo_bridge.tuning.process import TuningProcess
from servo_bridge.wire.link_queue import LinkDownError
from servo_msgs_py import topics


class TuningService(Part):
    """Executes the service and publishes the configuration of the board.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    node : Node
        Owner of service and topic.
    path : str
        File with the configuration.
    take : callable
        Starts a write of ``config.take`` like a command, in the thread of the node; the future has the tick of its
        effect.
    taken : callable
        Called in the thread of the node after a change of the blocks.
    requests : BoardRequests
        Executes the requests.
    """

    def __init__(
        self,
        context: BoardContext,
        node: Node,
        path: str,
        take: Callable[[CommandWrite], Future[int]],
        taken: Callable[[], None],
        requests: BoardRequests,
    ) -> None:
        self.path = path  # a change applies to the next call
        self._context = context
        self._requests = requests
        self._post = context.post
        self._take, self._taken = take, taken
        self._process = TuningProcess()
        self._waiting: Future[Outcome] | None = None  # answer of the call in progress
        self._published: list[Block] | None = None  # since the connection
        self._publisher = node.create_publisher(Int64MultiArray, topics.TUNING, latched_qos())
        self._service = DeferredService(node, SetBool, topics.TUNE, lambda request: self._on_tune(request.data))

    # ---- thread of the node
    @property
    def blocks(self) -> list[Block]:
        """Configuration of the board, by axis; empty: not known."""
        return self._published or []

    def connected(self) -> None:
        """After a connection, read and publish the configuration; a restarted twin needs it."""
        self._published = None
        self._requests.put(self._refresh)

    def close(self) -> None:
        """Abort the present request and answer its call."""
        self._process.close()
        if self._waiting is not None:
            self._answer(self._waiting, (False, "the bridge has closed the connection to the board"))

    def _on_tune(self, send: bool) -> Future[Outcome]:
        if not self.path:
            return answered(False, "the parameter tuning is empty; set it to the path of a TOML file first")
        if self._waiting is not None:
            return answered(False, "a tune request is in progress; call again after its response")
        self._waiting = answer = Future[Outcome]()
        self._requests.put(partial(self._tune, Path(self.path), send, answer))
        return answer

    def _answer(self, answer: Future[Outcome], outcome: Outcome) -> None:
        if answer is not self._waiting:
            return  # answered by `close`
        self._waiting = None
        success, message = outcome
        (self._context.info if success else self._context.warn)(f"tune: {message.splitlines()[-1]}")
        answer.set_result(outcome)

    def _publish(self, blocks: list[Block]) -> None:
        if blocks != self._published:
            self._published = blocks
            self._publisher.publish(blocks_message(blocks))

    # ---- thread of the requests
    def _tune(self, path: Path, send: bool, answer: Future[Outcome]) -> None:
        lines: list[str] = []
        success = unsure = False
        try:
            plan = self._plan(path, lines)
            if send and plan.axes:
                plan.send(self._requests)
                unsure = True
                lines.append(f"{plan.names} applied at tick {self._apply(plan)}")
            elif plan.axes:
                lines.append(f"the configuration of {plan.names} would change")
            success = True
        except BlockRefusedError as error:
            unsure = False
            lines.append(str(error))
        except ConfigError as error:
            lines.append(f"{path}: {error}")
        except Exception as error:  # includes internal errors: the service must respond
            lines.append(error_text(error))
        self._post(partial(self._answer, answer, (success, "\n".join(lines))))
        if unsure:
            self._post(self._taken)
            self._refresh()

    def _plan(self, path: Path, lines: list[str]) -> Plan:
        """Plan of the changes; appends warnings and a table to `lines`."""
        old = read_blocks(self._requests)
        blocks, warnings, notes = self._process.computed(path)
        lines += [f"{path}: {note}" for note in notes]
        lines += [f"{path}: warning: {warning}" for axis in range(AXES) for warning in warnings[axis]]
        plan = Plan(old, dict(enumerate(blocks)))
        if plan.axes:
            lines += plan.table()
        else:
            lines.append(f"the board already has the configuration of {path}; no change")
        return plan

    def _apply(self, plan: Plan) -> int:
        """Apply the transferred blocks on the board; returns the tick.

        Raises
        ------
        BlockRefusedError
            If the board refuses them.
        ConnectionError
            If the result is unknown.
        """
        table = AxisConfigTable.load()
        members = tuple(word for _, new in plan.changes.values() for word in table.words(new))
        write = CommandWrite("config.take", 0, (sum(1 << axis for axis in plan.axes),), members)
        begun: Future[Future[int]] = Future()
        self._post(lambda: begun.set_result(self._take(write)))
        try:
            return begun.result(TIMEOUT).result(TIMEOUT)
        except (ConnectionError, futures.TimeoutError):
            # The repeated request is refused because the first one was executed.
            in_force = self._requests.read_words("config.checksum")
            if all(in_force[axis] == checksum for axis, checksum in plan.checksums().items()):
                return self._requests.read_words("config.taken_tick")[0]
            take_result(self._requests)
            raise

    def _refresh(self) -> None:
        """Read and publish the configuration of the board; no blocks if it cannot be read."""
        blocks: list[Block] = []
        try:
            blocks = list(read_blocks(self._requests).values())
        except LinkDownError:
            return  # reported elsewhere; read again after the reconnection
        except Exception as error:  # includes internal errors: the thread continues
            self._post(partial(self._context.warn, f"the configuration of the board is not known: {error_text(error)}"))
        self._post(partial(self._publish, blocks))
