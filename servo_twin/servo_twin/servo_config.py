"""The configuration of the firmware, ``servo.toml``, and its integers for a virtual board."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.braking import brake_constants
from servo_tuning.configuration import Configuration
from servo_tuning.constants import time_outs
from servo_tuning.errors import ConfigError
from servo_tuning.passwords import password_hashes
from servo_tuning.reading import SERVO_TOML, complete, parse, read_table
from servo_tuning.tuned import tuned


@dataclass(frozen=True)
class ServoConfig:
    """Integers of ``servo_config_t``, as tuned from a ``servo.toml``."""

    blocks: tuple[tuple[int, ...], ...]  # raw members of each axis, in the order of the table
    board: Mapping[str, int]  # fields of ``bus_braking_config_t``, and timeouts [slow ticks]
    passwords: Mapping[int, bytes]  # SHA-1 by level; an omitted level has no password

    @classmethod
    def of(cls, configuration: Configuration) -> ServoConfig:
        """Compute the integers. Raises `ConfigError` if the configuration cannot work."""
        return cls(
            tuple(blocks_of_configuration(configuration).values()),
            {**brake_constants(configuration), **time_outs(configuration.board)},
            password_hashes(configuration.board.passwords),
        )

    @classmethod
    def load(cls, path: Path) -> ServoConfig:
        """Compute the integers for a file. Raises `ConfigError` with its name if it cannot work."""
        table = servo_table(path)
        try:
            return cls.of_table(table)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> ServoConfig:
        """Compute the integers for a parsed ``servo.toml``. Raises `ConfigError` if it cannot work."""
        return cls.of(parse(table, Catalogue.load()))

    def native(self, ffi: Any) -> tuple[Any, object]:
        """``board_servo_config_t *``, and the memory that it refers to, which the caller has to keep."""
        servo = ffi.new("board_servo_config_t *")
        members = [ffi.new("int32_t[]", block) for block in self.blocks]
        servo.member = members
        for name, value in self.board.items():
            setattr(servo, name, value)
        for level, digest in self.passwords.items():
            servo.password[level] = list(digest)
        return servo, members


def blocks_of_configuration(configuration: Configuration) -> dict[int, tuple[int, ...]]:
    """Raw members of the blocks by index of the axis. Raises `ConfigError` if the configuration cannot work."""
    table = AxisConfigTable.load()
    return {k: tuple(table.words(tuned(axis, configuration).block)) for k, axis in enumerate(configuration.axes)}


@functools.cache
def servo_table(path: Path = SERVO_TOML) -> Mapping[str, Any]:
    """A parsed ``servo.toml``; cached, do not modify it.

    Raises
    ------
    ConfigError
        If the file does not exist, is no TOML or is not complete; with its name.
    """
    if not path.is_file():
        raise ConfigError(f"no such file: {path}")
    try:
        table = read_table(path)
        complete(table, Catalogue.load())
        return table
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
