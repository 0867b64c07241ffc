"""The topic ``run_info``: what runs, for recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rclpy.node import Node
from servo_msgs_py.board_description import board_of
from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.run_file.run_info import RunInfo, software_version
from servo_msgs_py.run_file.virtual_board_file import read_virtual_board
from servo_msgs_py.runtime.qos import latched_qos
from servo_msgs_py.units import PERIOD_NS
from std_msgs.msg import String

from servo_bridge.freemaster.client import BoardInfo
from servo_msgs_py import topics


class RunInfoTopic:
    """Publishes the document whenever it has changed.

    Parameters
    ----------
    node : Node
        Owner.
    catalogue : Catalogue
        Table of variables.
    port : str
        Port of the board; a virtual board has a file beside it.
    settings : mapping
        Parameters of the node; a change applies to the next `refresh`.
    board : callable
        Identification of the board; None if it is not connected.
    parameters : callable
        Of the board; None if not known.
    configuration : callable
        Blocks of the axes; empty if not known.
    """

    def __init__(
        self,
        node: Node,
        catalogue: Catalogue,
        port: str,
        settings: Mapping[str, Any],
        board: Callable[[], BoardInfo | None],
        parameters: Callable[[], RawParameters | None],
        configuration: Callable[[], Sequence[Mapping[str, int]]],
    ) -> None:
        self._port, self.settings = port, settings
        self._board, self._parameters, self._configuration = board, parameters, configuration
        self._known = RunInfo(software=software_version(), catalogue=f"{catalogue.hash:08X}", tick_ns=PERIOD_NS)
        self._publisher = node.create_publisher(String, topics.RUN_INFO, latched_qos())

    def refresh(self) -> None:
        """Publish the document if it has changed; call it once a second."""
        board = self._board()
        known = replace(
            self._known,
            board={} if board is None else _identification(board),
            parameters=self._parameters() or {},
            configuration=self._configuration(),
            bridge=self.settings,
            virtual_board=read_virtual_board(self._port),
        )
        if known != self._known:
            self._known = known
            self._publisher.publish(String(data=known.text()))


def _identification(board: BoardInfo) -> dict[str, str]:
    known = {"name": board.name, "version": board.version, "build": board.build}
    return known | {"hardware": hardware} if (hardware := board_of(board.name)) else known
