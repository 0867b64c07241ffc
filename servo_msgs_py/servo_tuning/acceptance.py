"""All checks of a parsed ``servo.toml`` together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from servo_msgs_py.catalogue import Catalogue

from servo_tuning.braking import brake_constants
from servo_tuning.constants import time_outs
from servo_tuning.errors import ConfigError
from servo_tuning.reading import parse
from servo_tuning.tuned import tuned


def refusal_of(table: Mapping[str, Any]) -> ConfigError | None:
    """First refusal of a configuration; None: every number of it can be used."""
    try:
        configuration = parse(table, Catalogue.load())
        for axis in configuration.axes:
            tuned(axis, configuration)
        if configuration.board.complete:
            brake_constants(configuration)
        time_outs(configuration.board)
    except ConfigError as error:
        return error
    return None
