"""Test bench: a servo on the fake board with access to its configuration blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from servo_bench import TICK, Bench

OUT_OF_RANGE: Final = 0x97


class BlockBench(Bench):
    """Bench with the interface `servo_msgs_py.board_port.BoardPort`."""

    def read_words(self, name: str) -> list[int]:
        variable = self.catalogue.variables[name]
        data = self.core.ffi.new("uint8_t[]", variable.size)
        assert self.core.lib.servo_read(self.servo, self.address(name), data, variable.size) == 0
        return variable.decode_raw(bytes(data))

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        data = self.catalogue[name].pack(words)
        status = self.core.lib.servo_write(self.servo, self.address(name, first), data, len(data))
        assert status in (0, OUT_OF_RANGE)
        return bool(status == 0)

    def clock(self) -> float:
        return self.ticks * TICK

    def wait(self, seconds: float) -> None:
        self.slow(round(seconds / TICK))
