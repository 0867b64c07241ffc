"""File beside the port of a virtual board that says what it is: its program writes it, a bridge reads it."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

from servo_msgs_py.output_file import write_file
from servo_msgs_py.run_file.run_info import VirtualBoard, known
from servo_msgs_py.text_file import TextFileError, parse_json, read_text


def virtual_board_file(link: Path) -> Path:
    """File that belongs to the link of a port."""
    return link.with_name(f"{link.name}.json")


def write_virtual_board(link: Path, board: VirtualBoard) -> None:
    """Write the file of a virtual board.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    write_file(virtual_board_file(link), json.dumps(asdict(board), indent=1) + "\n")


def read_virtual_board(port: str) -> VirtualBoard | None:
    """Virtual board at a port; None if it is not one, or its program has ended."""
    link = Path(port)
    try:
        board = VirtualBoard(**known(VirtualBoard, parse_json(read_text(virtual_board_file(link)))))
        return board if os.readlink(link) == board.device else None
    except (OSError, TextFileError, ValueError, AttributeError):  # none, or not one of this version
        return None
