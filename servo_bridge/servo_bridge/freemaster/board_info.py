"""What a target says about itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

DEFAULT_MTU: Final = 32
"""Smallest allowed message buffer of version 4, until the target has named its own [bytes]."""


@dataclass(frozen=True)
class BoardInfo:
    """What a target says about itself; values that it does not know are None or empty."""

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
        """Whether numbers in the target's memory have their high byte first."""
        return bool(self.flags & 0x01)

    @property
    def password_level(self) -> int:
        """Lowest access level that needs a password: 0 none, 1 read, 2 write, 3 flash."""
        return self.flags >> 4 & 3
