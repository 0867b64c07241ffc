"""ROS time by a simulation: the topic ``/clock``, services to pause and to step, a parameter for the speed."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from servo_msgs_py.convert import to_stamp
from servo_msgs_py.runtime import ros_environment
from servo_msgs_py.runtime.node_shell import claim_name
from servo_msgs_py.runtime.parameters import declare, spec
from std_srvs.srv import SetBool, Trigger

SPEEDS: Final = (0.01, 100.0)
"""Range of the speed: simulated seconds per second."""

_NAME: Final = "simulation"
_INTERVAL_NS: Final = 1_000_000  # shortest simulated time between two messages of the clock [ns]


class SimulationClock:
    """The node ``/simulation``, served by the thread of the simulation.

    Parameters
    ----------
    set_speed : callable
        Sets the simulated seconds per second; 0 stops the time.
    step : callable
        Lets one step of a stopped time elapse.
    speed : float
        Speed at the start.

    Raises
    ------
    NameTakenError
        If another simulation has the clock of this ROS domain.
    """

    def __init__(self, set_speed: Callable[[float], None], step: Callable[[], None], speed: float) -> None:
        self._set_speed, self._step = set_speed, step
        self._paused, self._published_ns = False, -_INTERVAL_NS
        ros_environment.prepare()
        self._context = Context()
        self._context.init(args=None)
        self._node = Node(_NAME, context=self._context)
        try:
            claim_name(self._node)
        except BaseException:
            self._context.shutdown()
            raise
        speeds = spec(speed, "simulated seconds per second", *SPEEDS, read_only=False)
        self._speed = float(declare(self._node, {"speed": speeds})["speed"])
        self._node.add_on_set_parameters_callback(self._on_parameters)
        self._clock = self._node.create_publisher(Clock, "/clock", 10)
        self._node.create_service(SetBool, "~/pause", self._on_pause)
        self._node.create_service(Trigger, "~/step", self._on_step)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def __enter__(self) -> SimulationClock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._context.shutdown()

    def serve(self, time_ns: int) -> None:
        """Publish the simulated time [ns], and answer the requests that have arrived."""
        if time_ns - self._published_ns >= (1 if self._paused else _INTERVAL_NS):
            self._published_ns = time_ns
            self._clock.publish(Clock(clock=to_stamp(time_ns)))
        self._executor.spin_once(timeout_sec=0.0)

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "speed":
                self._speed = float(parameter.value)
        self._apply()
        return SetParametersResult(successful=True)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        self._apply()
        response.success = True
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._paused
        if self._paused:
            self._step()
        else:
            response.message = f"the simulation runs; call /{_NAME}/pause first"
        return response

    def _apply(self) -> None:
        self._set_speed(0.0 if self._paused else self._speed)
