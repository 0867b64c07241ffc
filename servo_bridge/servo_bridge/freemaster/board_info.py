"""Identification of a target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

DEFAULT_MTU: Final = 32
"""Smallest message buffer in version 4, assumed until the target has reported its size [bytes]."""


@dataclass(frozen=True)
class BoardInfo:
    """Identification of a target; values that it does not report are None or empty."""

    protocol: int = 4
    mtu: int = DEFAULT_MTU
    version: str = ""
    name: str = ""
    description: str = ""
    build: str = ""
    flags: int = 0
    base_address: int | None = None
    recorders: int = 0
    scopes: int = 0
    pipes: int = 0

    @property
    def big_endian(self) -> bool:
        """Whether multi-byte numbers of the target begin with the high byte."""
        return bool(self.flags & 0x01)

    @property
    def password_level(self) -> int:
        """Lowest access level that requires a password: 0 none, 1 read, 2 write, 3 flash."""
        return self.flags >> 4 & 3
