"""Test rig: what a fake chip has recorded of a port at register level."""

from __future__ import annotations

from typing import Any, NamedTuple

READ, WRITE, INTERRUPTS, SERVO = range(4)


class Access(NamedTuple):
    """One recorded access of the fake chip."""

    kind: int
    address: int
    value: int


class RecordedAccesses:
    """A port on a fake chip; a subclass makes its library."""

    lib: Any
    ffi: Any
    chip: Any
    hal: Any

    def init(self) -> bool:
        return bool(self.lib.port_init(self.hal, self.lib.fake_servo(self.chip), self.ffi.NULL))

    def forget(self) -> None:
        self.chip.accesses = 0

    @property
    def accesses(self) -> list[Access]:
        return [Access(a.kind, a.address, a.value) for a in self.chip.access[0 : self.chip.accesses]]

    @property
    def writes(self) -> list[tuple[int, int]]:
        return [(a.address, a.value) for a in self.accesses if a.kind == WRITE]

    def writes_of(self, address: int) -> list[int]:
        return [value for register, value in self.writes if register == address]
