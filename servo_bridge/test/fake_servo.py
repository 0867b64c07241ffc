"""A fake servo board: the variables of the catalogue on a `FakeTarget`, with a clock and a command latch."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import recorded_fault
from fake_target import CONST, ENUM, NONE, RO, RW, FakeEntry, FakeTarget
from servo_msgs_py.catalogue import Catalogue

BASE = 0x1000
CATALOGUE = Catalogue.load()


class FakeServo(FakeTarget):
    """Board whose telemetry has a running clock; a written command takes effect at the next slow tick.

    Like the firmware, it measures the time without a command or keep-alive of the host. It has no host time-out.
    """

    def __init__(
        self,
        catalogue: Catalogue = CATALOGUE,
        ticks: Callable[[], int] | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
        **options: object,
    ) -> None:
        super().__init__(mtu=254, scope_limit=28, config={"NM": f"servo/{catalogue.board.name}\0".encode()}, **options)  # type: ignore[arg-type]
        self.catalogue = catalogue
        self.clock = clock
        self.start_ns = clock()
        self.first_tick = 0
        self.ticks = ticks or (lambda: self.first_tick + (clock() - self.start_ns) // 62_500)
        self.host_signals: list[tuple[int, str]] = []  # commands and keep-alives: time [ns], name
        for name, code in catalogue.bits["command"].items():
            self.commands[code] = partial(self._record_command, name)
        self.addresses: dict[str, int] = {}
        self.written: list[tuple[str, int, bytes]] = []  # variable, offset, bytes; without the boot token
        self._command_pending = False
        table = self.tables[0]
        for name, constants in catalogue.enums.items():
            table.append(FakeEntry(name, ENUM, 0, 2, NONE))
            table.extend(FakeEntry(key, CONST, value, 0, NONE) for key, value in constants.items())
        address = BASE
        for v in catalogue.variables.values():
            size = v.size or (recorded_fault.SIZE if v.name.endswith("fault_record") else 120)
            kind = v.enum.encode() if v.enum else bytes([v.format.tsa])
            table.append(FakeEntry(v.name, kind, address, size, RW if v.writable else RO))
            self.addresses[v.name] = address
            address += (size + 3) & ~3
        self.build(0x3000)
        self.put("catalogue_hash", catalogue.hash)
        for name, value in (
            ("param.speed_limit", 100.0),
            ("param.acceleration_limit", 1000.0),
            ("param.i_q_limit", 2.0),
            ("param.position_min", -1000.0),
            ("param.position_max", 1000.0),
            ("param.following_error", 1.0),
            ("param.over_speed", 380.0),
        ):
            self.poke(self.addresses[name], catalogue[name].encode([value, value]))
        self.poke(self.addresses["param.host_timeout"], catalogue["param.host_timeout"].encode(0.5))
        self.accepts = self._in_range
        self.on_write = self._record_write
        self.before_scope = self._snapshot

    def put(self, name: str, *raw: int) -> None:
        """Set a variable to raw integers."""
        self.poke(self.addresses[name], self.catalogue[name].encode_raw(raw))

    def get(self, name: str) -> list[int]:
        """Raw integers of a variable."""
        v = self.catalogue[name]
        return v.decode_raw(self.peek(self.addresses[name], v.size))

    def restart(self) -> None:
        """Reset the board."""
        self.reset()
        self.start_ns, self.first_tick = self.clock(), 0
        self.host_signals.clear()
        for name in ("boot_token", "applied_tick", "applied_count"):
            self.put(name, 0)

    def _name(self, address: int) -> str:
        return max((n for n, a in self.addresses.items() if a <= address), key=self.addresses.__getitem__)

    def _in_range(self, address: int, data: bytes) -> bool:
        """True if the board accepts these elements."""
        name = self._name(address)
        v, offset = self.catalogue[name], address - self.addresses[name]
        if name == "boot_token" and self.get(name) != [0]:
            return False
        low, high = v.raw_range
        for axis, raw in enumerate(v.elements(data), offset // v.element_size):
            if not low <= raw <= high:
                return False
            if name == "cmd.position":
                away = (raw - self.get(f"axis{axis + 1}.position")[0] + 2**31) % 2**32 - 2**31
                if abs(away) > self.catalogue.bits["position"]["REACH"]:
                    return False
        return True

    def _record_write(self, address: int, data: bytes) -> None:
        name = self._name(address)
        if name == "boot_token":
            return
        self.written.append((name, address - self.addresses[name], data))
        if name.startswith("cmd."):
            self._command_pending = True
            self.host_signals.append((self.clock(), name))

    def _record_command(self, name: str, _: bytes) -> int:
        if name != "IDENTIFY":
            self.host_signals.append((self.clock(), name))
        self._command_pending = self._command_pending or name in ("QUICK_STOP", "CLEAR_FAULTS")
        return 0

    @property
    def host_silence_ns(self) -> int:
        """Longest time between two commands or keep-alives, or since the last one [ns]."""
        times = [time_ns for time_ns, _ in self.host_signals] + [self.clock()]
        return max((later - earlier for earlier, later in pairwise(times)), default=0)

    def _snapshot(self) -> None:
        tick = self.ticks() // 8 * 8
        if self._command_pending:
            self._command_pending = False
            self.put("applied_tick", tick % 2**32)
            self.put("applied_count", (self.get("applied_count")[0] + 1) % 65536)
        self.put("tick", tick % 2**32)
