"""The service ``record`` and the topics ``recorder`` and ``recording``: bursts of the recorder of the board."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from servo_msgs_py.convert import trace_message
from servo_msgs_py.recorder_setup import setup_message
from servo_msgs_py.runtime.qos import latched_qos
from servo_msgs_py.trace import Trace
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from servo_bridge.board_context import BoardContext
from servo_bridge.bursts.recording import POLL, BurstRecording, Phase
from servo_bridge.bursts.request import TICK, BurstRequest
from servo_bridge.deferred_service import DeferredService
from servo_bridge.outcome import Outcome, answered, error_of
from servo_bridge.part import Part
from servo_msgs_py import topics


class RecordService(Part):
    """Configures a recorder, and publishes its recording.

    The configuration is published before the recorder starts, because a twin must sample the same from the first point.

    Parameters
    ----------
    context : BoardContext
        Access to the board, the executor and the log.
    node : Node
        Owner of service and topics.
    request : BurstRequest
        Configuration of the recording.
    piece : int
        Bytes read between two samples of the telemetry.
    times : callable
        Converts uint32 ticks, oldest first, to extended ticks and ROS times [ns].
    """

    def __init__(
        self,
        context: BoardContext,
        node: Node,
        request: BurstRequest,
        piece: int,
        times: Callable[[Any], tuple[Any, Any]],
    ) -> None:
        self._context = context
        self._piece = piece
        self._times = times
        self._recording: BurstRecording | None = None
        self._answer: Future[Outcome] | None = None
        self.request = request  # a change applies to the next burst
        self._publisher = node.create_publisher(Float64MultiArray, topics.RECORDING, latched_qos())
        self._setups = node.create_publisher(Float64MultiArray, topics.RECORDER, latched_qos())
        self._setups.publish(setup_message(None))
        self._timer = node.create_timer(POLL, self._step, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._timer.cancel()
        self._service = DeferredService(node, SetBool, topics.RECORD, lambda request: self._on_record(request.data))

    def lost(self, reason: str) -> None:
        """End the recording without a result."""
        self._end(f"the link to the board was lost: {reason}")

    def _on_record(self, begin: bool) -> Future[Outcome]:
        if begin and self._recording is not None:
            return answered(False, f"{self._recording.phase.value}; call record with data: false to end it first")
        if begin:
            answer: Future[Outcome] = Future()
            self._answer = answer
            self._recording = BurstRecording(self.request.with_tick(), self._context.catalogue, self._piece)
            self._step()
            return answer
        if self._recording is None:
            return answered(False, "no recording in progress; call record with data: true first")
        self._recording.stop()
        return answered(True, "the recorder is stopped; its samples are read and published on recording")

    def _step(self) -> None:
        self._timer.cancel()
        recording = self._recording
        if recording is not None:
            self._context.when_done(self._context.call(recording.step), partial(self._stepped, recording))

    def _stepped(self, recording: BurstRecording, step: Future[Trace | None]) -> None:
        if recording is not self._recording:
            return
        error = error_of(step)
        if error is not None:
            self._end(error)
            return
        if recording.phase is Phase.READY:
            self._setups.publish(setup_message(recording.setup))
            self._step()
            return
        if self._answer is not None:
            answer, self._answer = self._answer, None
            self._context.info(f"recording {recording.text}")
            answer.set_result((True, recording.text))
        burst = step.result()
        if burst is not None:
            self._recording = None
            self._publish(burst, recording)
            self._setups.publish(setup_message(None))
        elif recording.phase is Phase.READING:
            self._step()
        else:
            self._timer.reset()

    def _end(self, reason: str) -> None:
        """End a recording without a result."""
        recording, self._recording = self._recording, None
        answer, self._answer = self._answer, None
        if answer is not None:
            answer.set_result((False, reason))
        elif recording is not None:
            self._context.warn(f"the recording has failed: {reason}")
        if recording is not None:
            self._setups.publish(setup_message(None))

    def _publish(self, burst: Trace, recording: BurstRecording) -> None:
        how = "" if recording.triggered or recording.request.trigger is None else ", stopped before the trigger"
        self._publisher.publish(table_of(burst, f"{recording.text}{how}", self._times))
        self._context.info(f"recorded {len(burst)} points{how}")


def table_of(burst: Trace, label: str, times: Callable[[Any], tuple[Any, Any]]) -> Float64MultiArray:
    """Message of a burst that includes the tick.

    Parameters
    ----------
    burst : Trace
        The points.
    label : str
        Description, for ``layout.dim[0].label``.
    times : callable
        Converts uint32 ticks, oldest first, to extended ticks and ROS times [ns].
    """
    ticks, stamps = times(burst[TICK].astype(np.int64))
    added = (ticks, burst.time, *np.divmod(stamps, 1_000_000_000))
    names = (TICK, topics.BURST_TIME, *topics.STAMP_COLUMNS)
    return trace_message(burst.changed(**dict(zip(names, added, strict=True))), label)
