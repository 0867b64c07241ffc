"""The group [board.passwords]: passwords of the access levels of the serial line."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from typing import Final

from servo_tuning.errors import refused
from servo_tuning.schema import check_table, unknown_name

LEVELS: Final = ("view", "command", "tune")
"""Access levels, from the lowest, in the order of ``ACCESS_VIEW``."""

_HASH: Final = re.compile(r"sha1:([0-9a-fA-F]{40})")
_VARIABLE: Final = re.compile(r"env:(\w+)")
_FORM: Final = 'write "sha1:" and the 40 digits of its SHA-1, or "env:" and the name of an environment variable'


def password_entries(value: object) -> Mapping[str, str]:
    """Check the entries of the levels that have a password; environment variables are not evaluated yet.

    Raises
    ------
    ConfigError
        If a level is unknown, or its entry has no valid form.
    """
    entries: dict[str, str] = {}
    for level, entry in check_table("board.passwords", value).items():
        where = f"board.passwords.{level}"
        if level not in LEVELS:
            raise unknown_name(where, level, LEVELS)
        if not isinstance(entry, str):
            raise refused(where, repr(entry), "not a string", _FORM)
        if not _HASH.fullmatch(entry) and not _VARIABLE.fullmatch(entry):
            # The entry may be the password itself: the message must not show it.
            raise refused(where, "...", "neither a hash nor an environment variable", _FORM)
        entries[level] = entry
    return entries


def password_constants(entries: Mapping[str, str]) -> dict[str, tuple[int, ...]]:
    """Fields of ``servo_config_t``; refusals as in `password_hashes`."""
    return {f"password[{level}]": tuple(digest) for level, digest in password_hashes(entries).items()}


def password_hashes(entries: Mapping[str, str]) -> dict[int, bytes]:
    """SHA-1 of the password by index of the level; an omitted level has no password.

    Raises
    ------
    ConfigError
        If an environment variable is not set.
    """
    return {LEVELS.index(level): _digest(level, entry) for level, entry in entries.items()}


def _digest(level: str, entry: str) -> bytes:
    """SHA-1 of the password."""
    if found := _HASH.fullmatch(entry):
        return bytes.fromhex(found[1])
    password = os.environ.get(entry.removeprefix("env:"), "")
    if not password:
        where = f"board.passwords.{level}"
        raise refused(where, entry, "the environment variable is not set, or empty", "set it to the password")
    return hashlib.sha1(password.encode("utf-8"), usedforsecurity=False).digest()
