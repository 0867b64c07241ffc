"""Access to the tuning tool for tests: the committed configuration with changed entries."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Iterator
from typing import Any, Final

from firmware_compiler import FIRMWARE
from hypothesis import strategies as st
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.quantity import Quantity
from servo_msgs_py.text_file import read_toml
from servo_tuning.configuration import Configuration
from servo_tuning.reading import parse
from servo_tuning.schema import AXIS_GROUPS, BOARD, BOARD_GROUPS
from servo_tuning.tuned import Tuned, tuned

FILE: Final = FIRMWARE / "config" / "servo.toml"
GENERATED: Final = FIRMWARE / "config" / "servo_config_gen.c"
CATALOGUE: Final = Catalogue.load()

_TABLE: Final = read_toml(FILE)


def table(**changes: object) -> dict[str, Any]:
    """A copy of the committed configuration; ``axis1__motor__r_s=1.0`` changes or adds an entry."""
    result: dict[str, Any] = copy.deepcopy(_TABLE)
    for path, value in changes.items():
        *groups, key = path.split("__")
        place = result
        for group in groups:
            place = place.setdefault(group, {})
        place[key] = value
    return result


def configuration(**changes: object) -> Configuration:
    return parse(table(**changes), CATALOGUE)


def axis(number: int = 1, /, **changes: object) -> Tuned:
    """Tuned values of one axis of the changed configuration."""
    whole = configuration(**changes)
    return tuned(whole.axes[number - 1], whole)


def case(beginning: str, reason: str, **changes: object) -> tuple[str, str, dict[str, object]]:
    """Start of a message, further text of it, and the changes that cause it: the entry in the start, such as
    ``axis1.motor.r_s = 1``, and `changes`."""
    named = re.fullmatch(r"(\w+(?:\.\w+)+) = (\S+)", beginning)
    entry = {named[1].replace(".", "__"): float(named[2])} if named else {}
    return beginning, reason, {**changes, **entry}


def entries() -> Iterator[tuple[str, Quantity]]:
    """Every number of the board and of axis 1: its name and its requirements."""
    for key, entry in BOARD.items():
        yield f"board.{key}", entry
    for group, keys in BOARD_GROUPS.items():
        for key, entry in keys.items():
            yield f"board.{group}.{key}", entry
    for group, keys in AXIS_GROUPS.items():
        for key, entry in keys.items():
            yield f"axis1.{group}.{key}", entry


def logarithmic(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers between two bounds, uniform in their logarithm."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)
