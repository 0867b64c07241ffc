"""``servo_bridge``: the board on a serial port as a managed ROS 2 node.

Contains parameters and lifecycle; `Supervisor` has the functions.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any, Final

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.serialization import deserialize_message
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.node_shell import claim_name, destroyed_on_error, full_name, run

from servo_bridge.board_link import LinkFactory
from servo_bridge.callback_watch import CallbackWatch
from servo_bridge.entities import Entities
from servo_bridge.parameters import PARAMETERS, ParameterError, declare, settings_from, values_of, watch
from servo_bridge.runs.message_tap import MessageTap
from servo_bridge.supervisor import Supervisor
from servo_bridge.unlocked_publisher import Sender
from servo_bridge.wire.link import Link

MESSAGE_BYTES_MAX: Final = 4096
"""Largest message of a topic; a JointState of two joints has 200 [bytes]."""

_READS: Final = ("get_", "list_", "describe_")
"""Beginnings of services that change nothing; their calls are not recorded."""


class ServoBridge(LifecycleNode):
    """The node of the bridge.

    It configures and activates itself unless the parameter ``autostart`` is false. From configure to cleanup a
    `Supervisor` exists, with the link and all topics and services except those of the lifecycle. The loss of the link
    does not change the lifecycle state: the link reconnects automatically, and motion needs ``enable`` then. After an
    exception in a transition the outputs are switched off and the node is unconfigured.

    Parameters
    ----------
    call_soon : callable
        Schedules a function in the executor; may be called from any thread.
    link_factory : LinkFactory
        Creates the link to the board.
    node_arguments : keyword arguments
        Arguments of `rclpy.node.Node`.

    Raises
    ------
    ParameterError
        If a parameter has the wrong type or is out of range; with ``autostart`` also if parameters are inconsistent.
    """

    def __init__(
        self,
        call_soon: Callable[[Callable[[], None]], object],
        *,
        link_factory: LinkFactory = Link,
        **node_arguments: Any,
    ) -> None:
        self.watch = CallbackWatch()  # of the executor; used by the entities that the base class creates
        self._sender = Sender(lambda text: self.get_logger().error(text))
        self.tap = MessageTap()  # of all messages, for recordings
        super().__init__("servo_bridge", namespace="servo", **node_arguments)
        self.failure = ""  # reason of a fatal error; the loss of the board is not fatal
        self.finished = False  # whether a transition has shut it down
        self.supervisor: Supervisor | None = None  # None while the node is unconfigured
        self._call_soon = call_soon
        self._link_factory = link_factory
        self._error: Exception | None = None  # of the last transition
        with destroyed_on_error(self):
            claim_name(self)
            self._catalogue = Catalogue.load()
            self._entities = Entities(self)
            values = declare(self)
            watch(self, self._catalogue, lambda: self.supervisor)
            self._reject_invalid_transitions()
            self._measure_services_of_rclpy()
            if values["autostart"]:
                self._start()
            else:
                self.get_logger().info(f"unconfigured; to continue: ros2 lifecycle set /{full_name(self)} configure")

    # ---- entities, whose callbacks are measured
    def create_publisher(self, msg_type: Any, *arguments: Any, **options: Any) -> Any:
        """As `Node.create_publisher`."""
        publisher = super().create_publisher(msg_type, *arguments, **options)
        return self._sender.unlocked(publisher, self.tap.of(publisher, msg_type))

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        *arguments: Any,
        raw: bool = False,
        bytes_max: int = MESSAGE_BYTES_MAX,
        **options: Any,
    ) -> Any:
        """As `Node.create_subscription`; a message of more bytes is refused before its conversion."""

        def take(data: bytes) -> None:
            if len(data) > bytes_max:
                self._reject(topic, f"the message has {len(data)} bytes, more than {bytes_max}; send a smaller one")
                return
            seen(data)
            if raw:
                callback(data)
                return
            try:
                message = deserialize_message(data, msg_type)
            except RuntimeError as error:
                self._reject(topic, f"the message is not a {msg_type.__name__} ({error}); send it again")
            else:
                callback(message)

        timed = self.watch.timed(f"topic {topic}", take)
        subscription = super().create_subscription(msg_type, topic, timed, *arguments, raw=True, **options)
        seen = self.tap.of(subscription, msg_type)
        return subscription

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], *arguments: Any, **options: Any
    ) -> Any:
        """As `Node.create_service`."""
        if srv_name.rpartition("/")[2].startswith(_READS):
            timed = self.watch.timed(f"service {srv_name}", callback)
            return super().create_service(srv_type, srv_name, timed, *arguments, **options)

        def called(request: Any, response: Any) -> Any:
            seen(request, "request")
            return callback(request, response)

        def answered(response: Any, header: Any) -> None:
            seen(response, "response")
            send(response, header)

        timed = self.watch.timed(f"service {srv_name}", called)
        service = super().create_service(srv_type, srv_name, timed, *arguments, **options)
        seen, send = self.tap.of_service(service.service_name, self.get_namespace()), service.send_response
        setattr(service, "send_response", answered)  # noqa: B010, rclpy looks it up at every call
        return service

    def create_timer(self, period: float, callback: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """As `Node.create_timer`."""
        timed = self.watch.timed(f"timer {getattr(callback, '__qualname__', 'callback')}", callback)
        return super().create_timer(period, timed, *arguments, **options)

    def shutdown(self) -> None:
        """Switch both axes off, close the port and destroy the node; takes a few seconds at most."""
        self._release("the bridge was stopped")
        self.destroy_node()

    def destroy_node(self) -> None:
        """Destroy the node and the lifecycle state machine, which would keep the node in the ROS graph."""
        self._sender.close()
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    # ---- transitions
    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Open the port, identify the board, publish the telemetry."""
        return self._carry_out(self._configure)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Permit the service ``enable`` to release set-points."""
        return self._carry_out(lambda: self._configured().activate())

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Block set-points and stop the axes; telemetry continues."""
        return self._carry_out(lambda: self._configured().deactivate())

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Switch the outputs off, close the port, remove topics and services."""
        return self._carry_out(lambda: self._release("the bridge was cleaned up"))

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Clean up and end the program, as after SIGTERM."""
        self.finished = True
        return self._carry_out(lambda: self._release("the bridge was stopped"))

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Clean up after an exception, and log it (rclpy does not)."""
        self.get_logger().error(f"a transition failed; cleaning up: {_with_traceback(self._error)}")
        try:
            self._release("a transition failed")
        except Exception as error:
            self.failure = f"clean-up after a failed transition failed: {_with_traceback(error)}"
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    # ---- details
    def _reject(self, topic: str, reason: str) -> None:
        if self.supervisor is not None:
            self.supervisor.reject(topic, reason)

    def _start(self) -> None:
        for transition in (self.trigger_configure, self.trigger_activate):
            transition()
            if self._error is not None:
                raise self._error

    def _configured(self) -> Supervisor:
        assert self.supervisor is not None
        return self.supervisor

    def _configure(self) -> None:
        settings = settings_from(values_of(self), self._catalogue)
        self._entities = Entities(self)
        try:
            self.supervisor = Supervisor(
                self, self._catalogue, settings, self._call_soon, self._link_factory, self.watch, self.tap
            )
        except ParameterError:
            self._entities.destroy()
            raise

    def _release(self, reason: str) -> None:
        supervisor, self.supervisor = self.supervisor, None
        try:
            if supervisor is not None:
                supervisor.close(reason)
        finally:
            self._sender.flush()
            self._entities.destroy()

    def _carry_out(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        self._error = None
        try:
            work()
        except ParameterError as error:
            self._error = error
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._error = error
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _measure_services_of_rclpy(self) -> None:
        """Measure the services that rclpy creates without `create_service`, such as those of the lifecycle."""
        for service in self.services:
            if not hasattr(service.callback, "__wrapped__"):
                service.callback = self.watch.timed(f"service {service.srv_name}", service.callback)

    def _reject_invalid_transitions(self) -> None:
        """Answer impossible transitions of the service change_state; in rclpy they end the executor."""
        service = self._service_change_state
        execute_request = service.callback

        def change_state(request: Any, response: Any) -> Any:
            requested, possible = request.transition, self._state_machine.available_transitions
            if not any(
                label == requested.label if requested.label else number == requested.id
                for number, label, *_ in possible
            ):
                self.get_logger().warning(
                    f"no transition {requested.label or requested.id} from state "
                    f"{self._state_machine.current_state[1]}; possible: "
                    f"{', '.join(label for _, label, *_ in possible) or 'none'}"
                )
                response.success = False
                return response
            response = execute_request(request, response)
            if isinstance(self._error, ParameterError):
                self.get_logger().error(f"not configured: {self._error}")
            return response

        service.callback = change_state


def _with_traceback(error: Exception | None) -> str:
    """Text of an exception with its traceback."""
    return "".join(traceback.format_exception(error)) if error is not None else "no exception"


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until Ctrl-C, SIGTERM or the transition shutdown; returns the exit status."""
    purpose = "ROS 2 node of a servo board: FreeMASTER protocol over a serial port; telemetry, set-points, services"
    return run("servo_bridge", purpose, PARAMETERS, lambda executor: ServoBridge(executor.create_task), args)


if __name__ == "__main__":
    sys.exit(main())
