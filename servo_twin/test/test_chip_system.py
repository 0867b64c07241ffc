"""Clocks, clock gates, pins, watchdog, interrupts, serial interface, register names of the part."""

from __future__ import annotations

from functools import partial
from typing import ClassVar

import pytest
from chip_rig import ADDRESS, HALF, PERIOD, PWM_PINS, ChipError, ChipRig, pwm_module, start_pwm
from native_library import Native

SERIAL = {"GPIOC_PER": 0x0180, "SIM_GPSCL": 1 << 14, "SIM_GPSCH": 1, "SCI0_RATE": 434, "SCI0_CTRL1": 0x000C,
          "SCI0_CTRL2": 0x0020}  # fmt: skip
BYTE = 8680
"""Bus clocks of ten bits at 115200 baud."""


class TestClocks:
    def test_pll_locks_and_switches(self, registers_c: Native) -> None:
        rig = ChipRig(registers_c, start=False)
        assert rig.read("OCCS_STAT") == 0x0010
        rig.write("OCCS_CTRL", 0x0080)
        assert rig.read("OCCS_STAT") == 0
        rig.step(5000)
        assert rig.read("OCCS_STAT") == 0x0060
        rig.write("OCCS_CTRL", 0x0081)
        assert rig.read("OCCS_STAT") & 3 == 2  # switching
        rig.step(100)
        assert rig.read("OCCS_STAT") == 0x0061

    def test_choosing_the_pll_before_its_lock_is_an_error(self, registers_c: Native) -> None:
        rig = ChipRig(registers_c, start=False)
        rig.write("OCCS_CTRL", 0x0080)
        with pytest.raises(ChipError, match="OCCS CTRL = 0081h: the PLL is chosen before it has locked"):
            rig.write("OCCS_CTRL", 0x0081)

    def test_the_crystal_needs_a_start_up_time(self, registers_c: Native) -> None:
        rig = ChipRig(registers_c, start=False)
        with pytest.raises(ChipError, match="external clock is chosen while there is none"):
            rig.write("OCCS_CTRL", 0x0094)
        rig = ChipRig(registers_c, start=False)
        rig.write("OCCS_OSCTL2", 0)
        rig.step(100_000)
        assert rig.read("OCCS_STAT") & 0x80
        rig.write("OCCS_CTRL", 0x0094)

    @pytest.mark.parametrize(("divby", "mhz"), [(0x2030, "98.000"), (0x2131, "50.000")])
    def test_a_wrong_divider_is_an_error(self, registers_c: Native, divby: int, mhz: str) -> None:
        rig = ChipRig(registers_c, start=False)
        rig.write("SIM_PCE0", 0xFFFF)
        rig.write("OCCS_DIVBY", divby)
        rig.write("OCCS_CTRL", 0x0080)
        rig.step(10_000)
        rig.write("OCCS_CTRL", 0x0081)
        rig.step(1000)
        with pytest.raises(ChipError, match=f"a timer starts while the bus clock is {mhz} MHz"):
            rig.write("TMRA1_CTRL", 0x3E80)

    def test_endless_wait_of_the_software_is_an_error(self, rig: ChipRig) -> None:
        def wait() -> None:
            while not rig.read("OCCS_STAT") & 0x80:
                pass

        with pytest.raises(ChipError, match="the software waits for OCCS STAT"):
            wait()


class TestAccess:
    @pytest.mark.parametrize("address", [0xE400 + 6, 0xDE00, 0xC000, 0xE1E0, 0xE6AA, 0xE6CF, 0xE556, 0x0100])
    def test_an_unknown_address_is_an_error(self, rig: ChipRig, address: int) -> None:
        assert rig.lib.try_read(rig.chip, address) == -1
        text = rig.ffi.string(rig.chip.core.bus.error).decode()
        assert f"({address:04X}h) is not modelled (at " in text

    def test_chip_stops_after_an_error(self, rig: ChipRig) -> None:
        with pytest.raises(ChipError):
            rig.write("ADC_GC1", 1)
        now = rig.now
        with pytest.raises(ChipError, match="ADC GC1"):
            rig.step(1000)
        assert rig.now == now

    @pytest.mark.parametrize("name", sorted(ADDRESS))
    def test_a_register_is_named_by_block_and_register(self, rig: ChipRig, name: str) -> None:
        block, register = name.split("_", 1)
        spoken = rig.name(ADDRESS[name])
        if block in ("XBARA", "XBARB", "INTC", "AOI") or register[:4] in ("RSLT", "OFFS"):
            assert spoken.startswith(block)
        elif block[:3] == "PWM" and len(block) == 5:
            assert spoken == f"{block[:4]} SM{block[4]} {register}"
        else:
            assert spoken.replace("Q", "") == f"{block} {register}"


class Interrupts:
    """Vectors 77 (PWM fault), 85 (M1) and 28 (encoder edge), and their priority fields."""

    FIELD: ClassVar[dict[int, tuple[str, int]]] = {
        77: ("INTC_IPR8", 8),
        85: ("INTC_IPR9", 8),
        87: ("INTC_IPR9", 12),
        28: ("INTC_IPR2", 6),
    }

    def enable(self, rig: ChipRig, **levels: int) -> None:
        values: dict[str, int] = {}
        for name, level in levels.items():
            register, shift = self.FIELD[int(name[1:])]
            values[register] = values.get(register, 0) | (level + 1) << shift
        rig.write_all(values)

    def start(self, rig: ChipRig) -> int:
        rig.write_all(PWM_PINS | pwm_module("A", PWMA1_INTEN=0x20, PWMA_FCTRL0=0xF0F1))
        start_pwm(rig, "A")
        rig.interrupts()
        rig.clear()
        return rig.now

    def m1(self, rig: ChipRig, clocks: int) -> None:
        def handler() -> int:
            rig.write("PWMA1_STS", 0x20)
            return clocks

        rig.handlers[85] = handler

    def fault(self, rig: ChipRig, clocks: int) -> None:
        def handler() -> int:
            rig.write("PWMA_FCTRL0", 0xF0F0)
            return clocks

        rig.handlers[77] = handler


class TestInterrupts(Interrupts):
    def test_a_higher_level_interrupts_a_lower_one(self, rig: ChipRig) -> None:
        self.m1(rig, 2000)
        self.fault(rig, 300)
        self.enable(rig, v85=1, v77=2)
        start = self.start(rig)
        rig.edges = [(start + 900, "E8", True)]
        rig.run(start + 4000)
        seen = [(e.clock - start, e.kind, e.a) for e in rig.events("enter", "leave")]
        assert seen == [(400, "enter", 85), (900, "enter", 77), (1200, "leave", 77), (2700, "leave", 85)]

    def test_an_equal_level_waits(self, rig: ChipRig) -> None:
        self.m1(rig, 2000)
        self.fault(rig, 300)
        self.enable(rig, v85=1, v77=1)
        start = self.start(rig)
        rig.edges = [(start + 900, "E8", True)]
        rig.run(start + 4000)
        seen = [(e.clock - start, e.kind, e.a) for e in rig.events("enter", "leave")]
        assert seen == [(400, "enter", 85), (2400, "leave", 85), (2400, "enter", 77), (2700, "leave", 77)]

    def test_a_lower_level_waits(self, rig: ChipRig) -> None:
        self.m1(rig, 2000)
        self.fault(rig, 300)
        self.enable(rig, v85=1, v77=0)
        start = self.start(rig)
        rig.edges = [(start + 900, "E8", True)]
        rig.run(start + 4000)
        assert rig.clocks("enter", a=77) == [start + 2400]

    def test_the_lower_vector_of_two_comes_first(self, rig: ChipRig) -> None:
        self.m1(rig, 100)
        rig.handlers[87] = lambda: rig.write("PWMA0_STS", 0x20)
        self.enable(rig, v85=1, v87=1)
        start = self.start(rig)
        rig.write("PWMA0_INTEN", 0x20)
        rig.run(start + 1000)
        assert [e.a for e in rig.events("enter")] == [85, 87]

    def test_requests_of_one_clock_are_seen_together(self, rig: ChipRig) -> None:
        """Compares of both modules in the same clock: vector 76 (PWMB) comes before 87 (PWMA)."""
        rig.write_all(pwm_module("A") | pwm_module("B", PWMB0_CTRL2=0))
        for letter, vector in (("A", 87), ("B", 76)):
            rig.write(f"PWM{letter}0_INTEN", 0x20)
            rig.handlers[vector] = partial(rig.write, f"PWM{letter}0_STS", 0x20)
        rig.write_all({"INTC_IPR9": 2 << 12, "INTC_IPR8": 2 << 6})
        start_pwm(rig, "A", outputs=False)
        start_pwm(rig, "B", outputs=False)
        rig.interrupts()
        rig.clear()
        rig.step(1000)
        assert [e.a for e in rig.events("enter")] == [76, 87]

    def test_disabled_and_masked_interrupts_wait(self, rig: ChipRig) -> None:
        self.m1(rig, 100)
        start = self.start(rig)
        rig.run(start + 1000)
        assert rig.events("enter") == []  # priority 0: off
        rig.write("INTC_CTRL", 0x0020)
        self.enable(rig, v85=1)
        rig.step(10)
        assert rig.events("enter") == []  # all off
        rig.write("INTC_CTRL", 0)
        rig.step(0)
        assert rig.clocks("enter", a=85) == [rig.now]


class TestTimeInAHandler(Interrupts):
    """Two clocks for each instruction, 30 for the entry of an interrupt.

    No run of these tests may end within a handler, because the stack of Python would be destroyed.
    """

    INSTRUCTION = 16

    @pytest.fixture
    def rig(self, registers_c: Native) -> ChipRig:
        return ChipRig(registers_c, core=(2.0, 30))

    def test_access_is_timed_by_the_executed_instructions(self, rig: ChipRig) -> None:
        def handler() -> int:
            rig.lib.try_spend(100 * self.INSTRUCTION)
            rig.write("PWMA1_STS", 0x20)
            rig.lib.try_spend(50 * self.INSTRUCTION)
            rig.read("PWMA0_VAL3")
            rig.lib.try_spend(25 * self.INSTRUCTION)
            return 7

        rig.handlers[85] = handler
        self.enable(rig, v85=1)
        start = self.start(rig)
        rig.run(start + 2000)
        assert rig.clocks("write", a=ADDRESS["PWMA1_STS"]) == [start + 400 + 30 + 200]
        assert rig.clocks("leave", a=85) == [start + 400 + 30 + 2 * 175 + 7]

    def test_fractions_of_a_clock_are_accumulated(self, rig: ChipRig) -> None:
        def handler() -> None:
            for _ in range(1600):
                rig.lib.try_spend(1)
                rig.read("PWMA0_VAL3")
            rig.write("PWMA1_STS", 0x20)

        rig.handlers[85] = handler
        self.enable(rig, v85=1)
        start = self.start(rig)
        rig.run(start + 2000)
        assert rig.clocks("write", a=ADDRESS["PWMA1_STS"]) == [start + 400 + 30 + 200]

    def test_duties_that_are_released_behind_the_load_wait_for_the_next_one(self, rig: ChipRig) -> None:
        instructions = [0]

        def handler() -> None:
            rig.write("PWMA1_STS", 0x20)
            rig.lib.try_spend(instructions[0] * self.INSTRUCTION)
            rig.write("PWMA0_VAL3", 600)
            rig.write("PWMA_MCTRL", 0x0701)

        rig.handlers[85] = handler
        self.enable(rig, v85=1)
        to_load = HALF - 400 - 30
        for instructions[0], in_time in ((to_load // 2 - 1, True), (to_load // 2 + 1, False)):
            start = self.start(rig)
            rig.run(start + PERIOD)
            assert (start + HALF in rig.clocks("load", a=0)) == in_time
            rig.write("PWMA_MCTRL", 0)
            rig.step(PERIOD)

    def test_an_interrupt_comes_between_two_statements_at_every_instant(self, rig: ChipRig) -> None:
        """The outer handler is not affected, except that it ends later by the duration of the inner one."""
        for delay in range(430, 460):
            seen: list[str] = []

            def outer(seen: list[str] = seen) -> int:
                rig.write("PWMA1_STS", 0x20)
                for _ in range(10):
                    rig.lib.try_spend(self.INSTRUCTION)
                    seen.append("out")
                return 10

            def inner(seen: list[str] = seen) -> int:
                seen.append("in")
                rig.write("PWMA_FCTRL0", 0xF0F0)
                return 40

            rig.handlers.update({85: outer, 77: inner})
            self.enable(rig, v85=1, v77=2)
            start = self.start(rig)
            rig.edges = [(start + delay, "E8", True)]
            rig.run(start + 2000)
            enter = rig.clocks("enter", a=77)[0] - start
            assert enter == delay
            assert rig.clocks("leave", a=85) == [start + 460 + 70]
            assert seen.index("in") == min((delay - 430) // 2, 10), "statements executed before the interrupt"
            rig.write("PWMA_MCTRL", 0)
            rig.pin("E8", False)
            rig.write("PWMA_FSTS0", 0x00FF)
            rig.step(PERIOD)


class TestWatchdog:
    def start(self, rig: ChipRig) -> None:
        rig.write("COP_CTRL", 0)
        rig.write("COP_TOUT", 390)
        rig.write("COP_CTRL", 0x0302)  # 8 MHz / 1024: 50 ms

    def test_the_watchdog_resets_after_its_time(self, rig: ChipRig) -> None:
        self.start(rig)
        rig.write("GPIOC_PER", 0x1234)
        begin = rig.now
        rig.run(begin + 391 * 12800 - 1)
        assert rig.boots == 1
        rig.step(1)
        assert rig.boots == 2
        assert rig.read("SIM_RSTAT") == 0x0020
        assert rig.read("GPIOC_PER") == 0

    def test_a_serviced_watchdog_does_not_reset(self, rig: ChipRig) -> None:
        self.start(rig)
        for _ in range(5):
            rig.step(390 * 12800)
            rig.write("COP_CNTR", 0x5555)
            rig.write("COP_CNTR", 0xAAAA)
        assert rig.boots == 1
        assert rig.chip.cop.services == 5

    @pytest.mark.parametrize("words", [(0xAAAA, 0x5555), (0x5555, 0x5555), (0xAAAA,), (0x5555, 0x1234, 0xAAAA)])
    def test_wrong_service_words_are_ignored(self, rig: ChipRig, words: tuple[int, ...]) -> None:
        self.start(rig)
        rig.step(390 * 12800)
        for word in words:
            rig.write("COP_CNTR", word)
        rig.step(20_000)
        assert rig.boots == 2

    def test_a_write_protected_watchdog_stays_on(self, rig: ChipRig) -> None:
        self.start(rig)
        rig.write("COP_CTRL", 0x0303)
        rig.write("COP_CTRL", 0)
        rig.step(400 * 12800)
        assert rig.boots == 2

    def test_the_watchdog_is_on_after_reset(self, registers_c: Native) -> None:
        rig = ChipRig(registers_c, start=False)
        rig.step(65536 * 12800 + 10)
        assert rig.boots == 2

    def test_a_software_reset_opens_all_switches(self, rig: ChipRig) -> None:
        rig.write_all(PWM_PINS | pwm_module("A"))
        start_pwm(rig, "A")
        rig.step(HALF)
        assert rig.gates[-1][3] != 0
        rig.write("SIM_CTRL", 0x0010)
        assert all(levels == 0 for _, levels in {n: x for _, _, n, x in rig.gates}.items())
        rig.step(1000)
        assert rig.boots == 2
        assert rig.read("SIM_RSTAT") == 0x0040


class TestSerial:
    @pytest.fixture
    def serial(self, rig: ChipRig) -> ChipRig:
        rig.write_all(SERIAL)
        return rig

    def test_sends_at_its_baud_rate(self, serial: ChipRig) -> None:
        begin = serial.now
        for byte in b"abcd":
            serial.write("SCI0_DATA", byte)
        serial.run(begin + BYTE - 1)
        assert serial.host_read() == b""
        serial.run(begin + BYTE)
        assert serial.host_read() == b"a"
        serial.run(begin + 4 * BYTE)
        assert serial.host_read() == b"bcd"
        assert serial.read("SCI0_STAT") & 0xC000 == 0xC000  # TDRE, TIDLE

    def test_writing_to_a_full_transmitter_is_refused(self, serial: ChipRig) -> None:
        for k in range(5):  # one in transmission, four waiting
            serial.write("SCI0_DATA", k)
        assert not serial.read("SCI0_STAT") & 0x8000
        assert serial.read("SCI0_CTRL2") >> 13 == 4
        with pytest.raises(ChipError, match="written while the transmitter is full"):
            serial.write("SCI0_DATA", 5)

    def test_background_runs_again_for_an_event_that_it_causes(self, serial: ChipRig) -> None:
        """The background waits for three bytes and takes one per run; each read causes the next run."""
        taken: list[int] = []

        def take_one() -> None:
            if serial.read("SCI0_CTRL2") >> 8 & 7 == 3 or taken:
                taken.extend([serial.read("SCI0_DATA")] if serial.read("SCI0_STAT") & 0x2000 else [])

        serial.background = take_one
        serial.host_write(b"xyz")
        serial.edges = [(serial.now + 4 * BYTE + k, "E8", k == 0) for k in range(2)]
        serial.step(5 * BYTE)
        assert bytes(taken) == b"xyz"

    def test_receives_into_the_fifo(self, serial: ChipRig) -> None:
        serial.host_write(b"xyz")
        serial.step(BYTE)
        assert serial.read("SCI0_STAT") & 0x2000
        serial.step(2 * BYTE)
        assert serial.read("SCI0_CTRL2") >> 8 & 7 == 3
        assert bytes(serial.read("SCI0_DATA") for _ in range(3)) == b"xyz"
        assert not serial.read("SCI0_STAT") & 0x2000

    def test_the_receive_flag_follows_the_watermark(self, serial: ChipRig) -> None:
        serial.write("SCI0_CTRL2", 0x0020 | 1 << 6)
        serial.host_write(b"xy")
        serial.step(BYTE)
        assert not serial.read("SCI0_STAT") & 0x2000
        serial.step(BYTE)
        assert serial.read("SCI0_STAT") & 0x2000

    def test_without_fifo_the_status_must_be_read_first(self, serial: ChipRig) -> None:
        serial.write("SCI0_CTRL2", 0)
        serial.host_write(b"x")
        serial.step(BYTE)
        serial.read("SCI0_DATA")
        assert serial.read("SCI0_STAT") & 0x2000  # not cleared: STAT had not been read
        serial.read("SCI0_DATA")
        assert not serial.read("SCI0_STAT") & 0x2000

    def test_overrun_blocks_until_cleared(self, serial: ChipRig) -> None:
        serial.host_write(b"abcdefgh")
        serial.step(5 * BYTE)
        assert serial.read("SCI0_STAT") & 0x0800
        assert bytes(serial.read("SCI0_DATA") for _ in range(4)) == b"abcd"
        serial.step(BYTE)
        assert serial.read("SCI0_CTRL2") >> 8 & 7 == 0  # OR is still set
        serial.write("SCI0_STAT", 0)
        serial.step(2 * BYTE)
        assert bytes(serial.read("SCI0_DATA") for _ in range(2)) == b"gh"
        assert serial.chip.sci.line.overruns == 2

    def test_interrupts_by_received_bytes(self, serial: ChipRig) -> None:
        got = serial.on(52, {}, read="SCI0_DATA")
        serial.write("INTC_IPR5", 1 << 6)
        serial.write("SCI0_CTRL1", 0x002C)
        serial.interrupts()
        begin = serial.now
        serial.host_write(b"ok")
        serial.step(3 * BYTE)
        assert [byte for _, byte in got] == [ord("o"), ord("k")]
        assert got[0][0] - begin == pytest.approx(BYTE, abs=1)

    @pytest.mark.parametrize(("rate", "good"), [(434, True), (446, True), (420, True), (480, False), (217, False)])
    def test_a_wrong_baud_rate_damages_bytes(self, serial: ChipRig, rate: int, good: bool) -> None:
        serial.write("SCI0_RATE", rate)
        serial.host_write(bytes([0x55, 0x0F]))
        serial.write("SCI0_DATA", 0x55)
        serial.step(3 * BYTE)
        received = serial.read("SCI0_DATA")
        assert (received == 0x55 and not serial.read("SCI0_STAT") & 0x0200) == good
        assert (serial.host_read() == b"\x55") == good

    def test_the_clock_of_the_interface_can_be_doubled(self, serial: ChipRig) -> None:
        serial.write("SIM_PCR", 1 << 13)
        serial.write("SCI0_RATE", 868)
        begin = serial.now
        serial.write("SCI0_DATA", 1)
        serial.run(begin + BYTE)
        assert serial.host_read() == b"\x01"

    @pytest.mark.parametrize(
        "broken", [{"SIM_GPSCL": 0, "SIM_GPSCH": 0}, {"GPIOC_PER": 0}, {"SCI0_CTRL1": 0}, {"SCI0_RATE": 0}]
    )
    def test_a_line_that_is_not_connected_transfers_nothing(self, rig: ChipRig, broken: dict[str, int]) -> None:
        rig.write_all(SERIAL | broken)
        rig.host_write(b"x")
        rig.write("SCI0_DATA", ord("y"))
        rig.step(5 * BYTE)
        assert rig.host_read() == b""
        assert not rig.read("SCI0_STAT") & 0x2000

    def test_another_interface_does_not_send_on_these_pins(self, rig: ChipRig) -> None:
        rig.write_all(SERIAL)
        rig.write_all({"SCI1_RATE": 434, "SCI1_CTRL1": 0x000C})
        rig.write("SCI1_DATA", 1)
        rig.step(3 * BYTE)
        assert rig.host_read() == b""


def test_a_pin_reads_its_level_in_either_direction(rig: ChipRig) -> None:
    rig.write("GPIOF_DDR", 0x0040)
    rig.write("GPIOF_DR", 0x00C0)
    rig.pin("F7", False)
    assert rig.read("GPIOF_RAWDATA") & 0x00C0 == 0x0040
    rig.pin("F7", True)
    assert rig.read("GPIOF_RAWDATA") & 0x00C0 == 0x00C0
    with pytest.raises(ChipError, match="GPIOF IENR = 0001h: interrupts of pins"):
        rig.write("GPIOF_IENR", 1)
