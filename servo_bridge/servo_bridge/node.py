"""``servo_bridge``: the board on a serial port as a managed ROS 2 node.

A thin shell: parameters, lifecycle, and a `Supervisor` that does the work.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.node_shell import claim_name, full_name, run, setting_up

from servo_bridge.board_link import LinkFactory
from servo_bridge.entities import Entities
from servo_bridge.parameters import PARAMETERS, ParameterError, declare, settings_from, values_of, watch
from servo_bridge.supervisor import Supervisor
from servo_bridge.wire.link import Link


class ServoBridge(LifecycleNode):
    """The node.

    It configures and activates itself unless the parameter ``autostart`` is false. A `Supervisor` lives from
    configure to cleanup, and with it the link, every topic and every service beside those of the lifecycle. A link that
    is lost does not change the state of the lifecycle: the link comes back by itself, and motion needs ``enable`` in
    any case. An exception in a transition does: the outputs go off, and the node is unconfigured.

    Parameters
    ----------
    call_soon : callable
        Makes the executor call a function in its own thread; may be called from any thread.
    link_factory : LinkFactory
        Makes the link to the board.
    node_arguments : keyword arguments
        For `rclpy.node.Node`.

    Raises
    ------
    ParameterError
        If a parameter has the wrong type or is out of range; with ``autostart`` also if it does not make sense.
    """

    def __init__(
        self,
        call_soon: Callable[[Callable[[], None]], object],
        *,
        link_factory: LinkFactory = Link,
        **node_arguments: Any,
    ) -> None:
        super().__init__("servo_bridge", namespace="servo", **node_arguments)
        self.failure = ""  # why it cannot go on; a lost board is no reason, it waits for one that comes back
        self.finished = False  # whether a transition has shut it down
        self.supervisor: Supervisor | None = None  # None while the node is unconfigured
        self._call_soon = call_soon
        self._link_factory = link_factory
        self._error: Exception | None = None  # of the last transition
        with setting_up(self):
            claim_name(self)
            self._catalogue = Catalogue.load()
            self._entities = Entities(self)
            values = declare(self)
            watch(self, self._catalogue, lambda: self.supervisor)
            self._answer_every_transition()
            if values["autostart"]:
                self._start()
            else:
                self.get_logger().info(f"unconfigured; go on with: ros2 lifecycle set /{full_name(self)} configure")

    def shutdown(self) -> None:
        """Switch both axes off, close the port and end the node; takes a few seconds at most."""
        self._release("the bridge was stopped")
        self.destroy_node()

    def destroy_node(self) -> None:
        """As for every node; what holds the state of the lifecycle would keep it in the ROS graph."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    # ---- transitions
    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Open the port, identify the board, publish its telemetry."""
        return self._carry_out(self._configure)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Let the service ``enable`` open the gate of set-points."""
        return self._carry_out(lambda: self._configured().activate())

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Shut the gate of set-points and stop the axes; telemetry goes on."""
        return self._carry_out(lambda: self._configured().deactivate())

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Switch the outputs off, close the port, take topics and services back."""
        return self._carry_out(lambda: self._release("the bridge was cleaned up"))

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Clean up and end the program, as SIGTERM does."""
        self.finished = True
        return self._carry_out(lambda: self._release("the bridge was stopped"))

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Clean up after an exception, which rclpy itself does not show."""
        self.get_logger().error(f"a transition failed; cleaning up: {_with_places(self._error)}")
        try:
            self._release("a transition failed")
        except Exception as error:
            self.failure = f"no clean-up after a transition that failed: {_with_places(error)}"
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    # ---- details
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
            self.supervisor = Supervisor(self, self._catalogue, settings, self._call_soon, self._link_factory)
        except ParameterError:
            self._entities.destroy()
            raise

    def _release(self, reason: str) -> None:
        supervisor, self.supervisor = self.supervisor, None
        try:
            if supervisor is not None:
                supervisor.close(reason)
        finally:
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

    def _answer_every_transition(self) -> None:
        """Have the service change_state answer also what is not possible; rclpy ends the executor by it."""
        service = self._service_change_state
        carry_out = service.callback

        def change_state(request: Any, response: Any) -> Any:
            asked, possible = request.transition, self._state_machine.available_transitions
            if not any(label == asked.label if asked.label else number == asked.id for number, label, *_ in possible):
                self.get_logger().warning(
                    f"no transition {asked.label or asked.id} from state {self._state_machine.current_state[1]}; there "
                    f"are {', '.join(label for _, label, *_ in possible) or 'none'}"
                )
                response.success = False
                return response
            response = carry_out(request, response)
            if isinstance(self._error, ParameterError):
                self.get_logger().error(f"not configured: {self._error}")
            return response

        service.callback = change_state


def _with_places(error: Exception | None) -> str:
    """An exception with its traceback."""
    return "".join(traceback.format_exception(error)) if error is not None else "no exception"


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until Ctrl-C, SIGTERM or the transition shutdown; returns the exit status."""
    purpose = (
        "The bridge: speaks FreeMASTER with the board on a serial port; variables become topics, topics set-points"
    )
    return run("servo_bridge", purpose, PARAMETERS, lambda executor: ServoBridge(executor.create_task), args)


if __name__ == "__main__":
    sys.exit(main())
