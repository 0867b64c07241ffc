"""Test bench: a servo on the fake board with access to its configuration blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from core_library import Core
from servo_bench import Bench

OUT_OF_RANGE: Final = 0x97


class BlockBench(Bench):
    """Bench with the interface `servo_msgs_py.axis_config_transfer.BlockMemory`."""

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.waits = 0

    def read_words(self, name: str) -> list[int]:
        variable = self.catalogue.variables[name]
        data = self.core.ffi.new("uint8_t[]", variable.size)
        assert self.core.lib.servo_read(self.servo, self.address(name), data, variable.size) == 0
        return variable.decode_raw(bytes(data))

    def write_words(self, name: str, words: Sequence[int]) -> bool:
        variable = self.catalogue.variables[name]
        data = variable.pack(words)
        status = self.core.lib.servo_write(self.servo, self.address(name), data, len(data))
        assert status in (0, OUT_OF_RANGE)
        return bool(status == 0)

    def tick(self) -> bool:
        """Run one slow tick; False after 10 calls."""
        self.waits += 1
        self.slow()
        return self.waits < 10
