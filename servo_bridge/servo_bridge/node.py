"""``servo_bridge``: the board on a serial port as a ROS 2 node.

A thin shell: parameters, and a `Supervisor` that does the work.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.node_shell import claim_name, run, setting_up

from servo_bridge.parameters import PARAMETERS, declare, watch
from servo_bridge.supervisor import LinkFactory, Supervisor
from servo_bridge.wire.link import Link

__all__ = ["ServoBridge", "main"]


class ServoBridge(Node):
    """The node.

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
        If a parameter does not make sense.
    """

    def __init__(
        self,
        call_soon: Callable[[Callable[[], None]], object],
        *,
        link_factory: LinkFactory = Link,
        **node_arguments: Any,
    ) -> None:
        super().__init__("servo_bridge", namespace="servo", **node_arguments)
        self.failure = ""  # nothing ends this node: it waits for a board that comes back
        with setting_up(self):
            claim_name(self)
            catalogue = Catalogue.load()
            settings = declare(self, catalogue)
            self.supervisor = Supervisor(self, catalogue, settings, call_soon, link_factory)
            watch(self, catalogue, self.supervisor.settings_changed, self.supervisor.refuse_settings)

    def shutdown(self) -> None:
        """Switch both axes off, close the port and end the node; takes a few seconds at most."""
        self.supervisor.close()
        Node.destroy_node(self)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; returns the exit status."""
    purpose = (
        "The bridge: speaks FreeMASTER with the board on a serial port; variables become topics, topics set-points"
    )
    return run("servo_bridge", purpose, PARAMETERS, lambda executor: ServoBridge(executor.create_task), args)


if __name__ == "__main__":
    sys.exit(main())
