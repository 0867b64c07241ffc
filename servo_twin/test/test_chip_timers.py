"""Quad timers as used in the reference design (DRM 2.4): position, time stamp, index, age of the last edge."""

from __future__ import annotations

import random
from typing import Any

import pytest
from chip_rig import ChipError, ChipRig, pin
from native_library import Native

TICK = 128
"""Bus clocks per count of the time stamps."""

LINES = {"GPIOC_PER": 0x001C, "SIM_GPSCL": 1 << 4, "GPIOF_PER": 0x0100, "SIM_GPSFH": 1}
"""A and B of encoder 1 on C3 (TA0) and C4 (TA1), of encoder 2 on C2 (TB0) and F8 (TB1)."""


def timer(letter: str, **changes: int) -> dict[str, int]:
    """The four channels of one encoder."""
    values = {
        "0_COMP1": 3999, "0_COMP2": -3999, "0_LOAD": 0, "0_CNTR": 0, "0_CTRL": 0x80A5, "0_SCTRL": 0x00C0,
        "1_CTRL": 0x3E80, "1_SCTRL": 0x00C0, "2_CTRL": 0x2800,
        "3_CTRL": 0x3E80, "3_SCTRL": 0x00C0, "3_CSCTRL": 0x0800, "3_LOAD": 0,
    } | changes  # fmt: skip
    return {f"TMR{letter}{name}": value for name, value in values.items()}


class Encoder:
    """Lines of an encoder: A leads B when counting up. One count per step."""

    def __init__(self, rig: ChipRig, a: str = "C3", b: str = "C4") -> None:
        self.rig, self.pins, self.position = rig, (a, b), 0

    def turn(self, counts: int, clocks: int = 1000) -> None:
        for _ in range(abs(counts)):
            self.rig.step(clocks)
            self.position += 1 if counts > 0 else -1
            phase = self.position % 4
            for name, level in zip(self.pins, (phase in (1, 2), phase in (2, 3)), strict=True):
                self.rig.pin(name, level)


@pytest.fixture
def encoder(rig: ChipRig) -> Encoder:
    rig.write_all(LINES | timer("A") | timer("B"))
    rig.clear()
    return Encoder(rig)


def signed(value: int) -> int:
    return value - 0x10000 if value & 0x8000 else value


def count(rig: ChipRig) -> int:
    return signed(rig.read("TMRA0_CNTR"))


class TestPosition:
    def test_four_counts_per_line_in_both_directions(self, rig: ChipRig, encoder: Encoder) -> None:
        encoder.turn(10)
        assert count(rig) == 10
        assert rig.read("TMRA0_CSCTRL") & 0x0200
        encoder.turn(-25)
        assert count(rig) == -15
        assert not rig.read("TMRA0_CSCTRL") & 0x0200

    def test_wraps_to_zero_in_both_directions(self, rig: ChipRig, encoder: Encoder) -> None:
        """DRM F12: 0 .. 3999 upwards, 0 .. -3999 downwards."""
        seen = []
        encoder.turn(3998, 10)
        for _ in range(3):
            encoder.turn(1)
            seen.append(count(rig))
        rig.write("TMRA0_CNTR", 0)
        encoder.turn(-3998, 10)
        for _ in range(3):
            encoder.turn(-1)
            seen.append(count(rig))
        assert seen == [3999, 0, 1, -3999, 0, -1]

    def test_a_compare_value_equal_to_load_stops_counting_down(self, rig: ChipRig, encoder: Encoder) -> None:
        """COMP2 = 0, equal to LOAD: when counting down the counter is reloaded at every further edge and stays 0."""
        rig.write("TMRA0_COMP2", 0)
        encoder.turn(5)
        encoder.turn(-20)
        assert count(rig) == 0

    def test_comp2_of_the_wrong_sign_prevents_the_wrap(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA0_COMP2", 3999)
        encoder.turn(-4500, 10)
        assert count(rig) == -4500  # no wrap downwards

    def test_without_length_the_counter_does_not_wrap(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA0_CTRL", 0x8085)
        encoder.turn(4100, 10)
        assert count(rig) == 4100

    def test_swapped_lines_count_backwards(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA0_CTRL", 0x80A5 & ~0x1E80 | 1 << 9)  # primary input 1, secondary input 0
        encoder.turn(7)
        assert count(rig) == -7

    def test_a_wrong_pin_function_disconnects_the_encoder(self, rig: ChipRig, encoder: Encoder) -> None:
        """B is not connected to the timer: A alone counts up and down."""
        rig.write("SIM_GPSCL", 1 << 4 | 1 << 8)
        encoder.turn(40)
        assert count(rig) in (0, 1)

    def test_an_input_that_loses_its_pin_goes_low(self, rig: ChipRig, encoder: Encoder) -> None:
        encoder.turn(2)  # both lines are high
        rig.write("TMRA0_SCTRL", 0)
        assert rig.read("TMRA0_SCTRL") & 0x0100
        rig.write("SIM_GPSCL", 1 << 4 | 1 << 8)
        assert not rig.read("TMRA0_SCTRL") & 0x0100
        rig.write("SIM_GPSCL", 1 << 4)
        assert rig.read("TMRA0_SCTRL") & 0x0100

    @pytest.mark.parametrize(
        ("code", "expected"),
        [(0x4000 | 0x3F00, [0, 1, 0]), (0x8000 | 0x3F00, [1, 0, 1]), (0xFF00, [1, 1, 1]), (0x3F00, [0, 0, 0])],
    )
    def test_the_aoi_passes_inverts_and_forces(self, rig: ChipRig, code: int, expected: list[int]) -> None:
        """XB_IN2 on E4 is input A of event 0, which is connected to TA2: passed, inverted, forced to 1 and to 0."""
        rig.write_all({"GPIOE_PER": 0x0010, "SIM_GPSEL": 0x0100, "SIM_IPS0": 0x0400, "XBARB_SEL0": 14})
        rig.write_all({"AOI_BFCRT01_0": code, "XBARA_SEL25": 46 << 8, "TMRA2_CTRL": 0x0100})
        seen = []
        for level in (False, True, False):
            rig.pin("E4", level)
            seen.append(rig.read("TMRA2_SCTRL") >> 8 & 1)
        assert seen == expected

    def test_inputs_can_come_from_the_crossbar(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("SIM_IPS0", 0x0300)
        encoder.turn(8)
        assert count(rig) == 0  # not connected
        rig.write("GPIOE_PER", 0x0030)
        rig.write("SIM_GPSEL", 0x0500)  # E4, E5: XB_IN2, XB_IN3
        rig.write("XBARA_SEL24", 2 << 8)  # TA0_IN
        rig.write("XBARA_SEL25", 3)  # TA1_IN
        Encoder(rig, "E4", "E5").turn(8)
        assert count(rig) == 8

    def test_a_disabled_timer_does_not_count(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA0_ENBL", 0x000E)
        encoder.turn(5)
        assert count(rig) == 0

    def test_both_encoders_count_independently(self, rig: ChipRig, encoder: Encoder) -> None:
        other = Encoder(rig, "C2", "F8")
        encoder.turn(5)
        other.turn(-6)
        assert (count(rig), signed(rig.read("TMRB0_CNTR"))) == (5, -6)

    def test_filter_suppresses_shorter_pulses(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA0_FILT", 0x0105)  # 4 samples, 5 clocks apart, on input 0
        rig.write("TMRA1_FILT", 0x0105)
        rig.pin("C3", True)
        rig.step(19)
        rig.pin("C3", False)
        rig.step(100)
        assert count(rig) == 0
        encoder.turn(6)
        rig.step(20)
        assert count(rig) == 6
        encoder.turn(40, 7)  # a quarter period shorter than the filter: edges are lost
        rig.step(20)
        assert count(rig) != 46


class TestIndex:
    def test_one_pulse_per_turn(self, rig: ChipRig, encoder: Encoder) -> None:
        """DRM F13: OFLAG, set on compare, cleared on the next B edge, clocks TMRA2, which counts up only."""
        encoder.turn(3999 + 2 * 4000, 5)
        assert rig.read("TMRA2_CNTR") == 3
        encoder.turn(-3 * 4000 - 3997, 5)
        assert rig.read("TMRA2_CNTR") == 5
        encoder.turn(-1, 5)
        assert rig.read("TMRA2_CNTR") == 6

    def test_touching_the_compare_value_causes_a_pulse_without_a_turn(self, rig: ChipRig, encoder: Encoder) -> None:
        encoder.turn(3999, 5)
        encoder.turn(-10, 5)
        assert rig.read("TMRA2_CNTR") == 1
        assert count(rig) == 3989
        encoder.turn(10, 5)
        assert rig.read("TMRA2_CNTR") == 2

    def test_an_output_that_is_never_cleared_counts_one_revolution(self, rig: ChipRig, encoder: Encoder) -> None:
        """OUTMODE 2 instead of 5: after the first revolution OFLAG stays set, so no further revolution is counted."""
        rig.write("TMRA0_CTRL", 0x80A2)
        encoder.turn(3999 + 2 * 4000, 5)
        assert rig.read("TMRA2_CNTR") == 1

    def test_toggle_mode_halves_the_index(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA0_CTRL", 0x80A3)
        encoder.turn(3999 + 3 * 4000, 5)
        assert rig.read("TMRA2_CNTR") == 2

    def test_cascade_counts_signed_turns(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA2_CTRL", 0xE800)
        encoder.turn(3999 + 4000, 5)
        assert signed(rig.read("TMRA2_CNTR")) == 2
        encoder.turn(-3 * 4000 - 3998 - 1, 5)
        assert signed(rig.read("TMRA2_CNTR")) == -1

    def test_a_counter_with_the_wrong_source_does_not_count(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA2_CTRL", 0x2A00)  # output of counter 1
        encoder.turn(3999 + 4000, 5)
        assert rig.read("TMRA2_CNTR") == 0
        with pytest.raises(ChipError, match="TMRA2 CTRL = 2C00h: a channel cannot count its own output"):
            rig.write("TMRA2_CTRL", 0x2C00)


class TestTime:
    def test_the_time_stamp_counts_the_bus_clock_over_128(self, rig: ChipRig, encoder: Encoder) -> None:
        begin, clock = rig.read("TMRA1_CNTR"), rig.now
        rig.step(1_000_000)
        assert rig.read("TMRA1_CNTR") - begin == rig.now // TICK - clock // TICK

    def test_capture_on_both_edges_of_b(self, rig: ChipRig, encoder: Encoder) -> None:
        encoder.turn(2)  # B rises
        assert rig.read("TMRA0_SCTRL") & 0x0900 == 0x0900  # IEF, INPUT
        assert rig.read("TMRA0_CAPT") == 2  # the count includes the edge
        assert rig.read("TMRA1_CAPT") == rig.read("TMRA1_CNTR")
        for n in (0, 1, 3):
            rig.write(f"TMRA{n}_SCTRL", 0x00C0)
        encoder.turn(2)  # B falls
        assert rig.read("TMRA0_CAPT") == 4

    def test_captures_are_frozen_while_ief_is_set(self, rig: ChipRig, encoder: Encoder) -> None:
        encoder.turn(2)
        stamp = rig.read("TMRA1_CAPT")
        encoder.turn(20)
        assert (rig.read("TMRA0_CAPT"), rig.read("TMRA1_CAPT")) == (2, stamp)
        rig.write("TMRA0_SCTRL", 0x08C0)  # writing 1 does not clear
        encoder.turn(4)
        assert rig.read("TMRA0_CAPT") == 2
        rig.write("TMRA0_SCTRL", 0x00C0)
        assert not rig.read("TMRA0_SCTRL") & 0x0800
        encoder.turn(4)
        assert rig.read("TMRA0_CAPT") == 28

    def test_the_capture_mode_selects_the_edge(self, rig: ChipRig, encoder: Encoder) -> None:
        for mode, expected in ((0x0040, 2), (0x0080, 4), (0x0000, 0)):
            rig.write("TMRA0_CNTR", 0)
            rig.write("TMRA0_CAPT", 0)
            rig.write("TMRA0_SCTRL", mode)
            encoder.turn(4)
            assert rig.read("TMRA0_CAPT") == expected

    def test_reload_on_capture(self, rig: ChipRig, encoder: Encoder) -> None:
        """TMRA3 counts the age of the last captured edge; its capture is the interval between two edges."""
        encoder.turn(2)
        rig.write("TMRA3_SCTRL", 0x00C0)
        assert rig.read("TMRA3_CNTR") == 0
        encoder.turn(2, 50 * TICK)
        assert rig.read("TMRA3_CAPT") == 100
        assert rig.read("TMRA3_CNTR") == 0
        encoder.turn(2, 50 * TICK)  # IEF blocks the capture, and the reload with it
        assert rig.read("TMRA3_CNTR") == 100

    def test_without_roc_the_timer_does_not_measure_the_age(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.write("TMRA3_CSCTRL", 0)
        rig.step(30 * TICK)
        encoder.turn(2)
        assert rig.read("TMRA3_CNTR") >= 30

    def test_age_overflows_at_standstill(self, rig: ChipRig, encoder: Encoder) -> None:
        encoder.turn(2)
        rig.write("TMRA3_SCTRL", 0x00C0)
        rig.step(65535 * TICK - 1000)
        assert not rig.read("TMRA3_SCTRL") & 0x2000
        rig.step(2000)
        assert rig.read("TMRA3_SCTRL") & 0x2000
        rig.write("TMRA3_SCTRL", 0x00C0)
        assert not rig.read("TMRA3_SCTRL") & 0x2000

    def test_hold_is_a_snapshot(self, rig: ChipRig, encoder: Encoder) -> None:
        encoder.turn(5)
        rig.read("TMRA0_CNTR")
        stamp = rig.read("TMRA1_HOLD")
        rig.step(100 * TICK)
        encoder.turn(5)
        assert (rig.read("TMRA1_HOLD"), rig.read("TMRA0_HOLD")) == (stamp, 5)
        rig.read("TMRA3_CNTR")
        assert rig.read("TMRA1_HOLD") >= stamp + 100
        assert rig.read("TMRA0_HOLD") == 10

    def test_hold_is_latched_by_the_read(self, rig: ChipRig, encoder: Encoder) -> None:
        before = rig.read("TMRA1_CNTR")
        rig.step(100 * TICK)
        rig.read("TMRA0_CNTR")
        rig.step(7 * TICK)
        assert rig.read("TMRA1_HOLD") == before + 100
        encoder.turn(2)  # the capture of channel 3 reloads it
        assert rig.read("TMRA1_HOLD") == before + 100

    def test_hold_before_a_reload(self, rig: ChipRig, encoder: Encoder) -> None:
        rig.step(100 * TICK)
        rig.read("TMRA0_CNTR")
        age = rig.read("TMRA3_HOLD")
        rig.step(10 * TICK)
        rig.read("TMRA0_CNTR")
        encoder.turn(2)
        assert rig.read("TMRA3_CNTR") == 0
        rig.write("TMRA3_CNTR", 500)
        encoder.turn(1)
        rig.read("TMRA0_CNTR")
        rig.write("TMRA3_CNTR", 1000)
        assert (age >= 100, 500 <= rig.read("TMRA3_HOLD") < 520) == (True, True)

    def test_a_captured_edge_calls_its_handler(self, rig: ChipRig, encoder: Encoder) -> None:
        calls = rig.on(28, {"TMRA0_SCTRL": 0x00C0}, read="TMRA0_CAPT")
        rig.write("INTC_IPR2", 1 << 6)
        rig.write("TMRA0_SCTRL", 0x04C0)
        rig.interrupts()
        begin = rig.now
        rig.edges = [(begin + 500, "C3", True), (begin + 777, "C4", True), (begin + 1500, "C3", False)]
        rig.step(3000)
        assert calls == [(begin + 777, 2)]

    def test_compare_interrupt_of_a_bus_channel(self, rig: ChipRig) -> None:
        calls = rig.on(23, {"TMRB1_SCTRL": 0x4000})
        rig.write("INTC_IPR1", 1 << 12)
        rig.write_all({"TMRB1_COMP1": 99, "TMRB1_SCTRL": 0x4000, "TMRB1_CTRL": 0x3020})  # bus clock, LENGTH
        rig.interrupts()
        begin = rig.now
        rig.step(350)
        assert calls == [begin + 99, begin + 199, begin + 299]


FILTERS = {"TMRA0_FILT": 0x0105, "TMRA1_FILT": 0x0105}
WATCHED = ("TMRA0_CNTR", "TMRA0_CAPT", "TMRA0_SCTRL", "TMRA0_CSCTRL", "TMRA1_CAPT", "TMRA2_CNTR", "TMRA3_CNTR")


class TestDeferrableEdges:
    """Edges that are only counted may be processed later without a visible difference."""

    @staticmethod
    def edges(chance: random.Random, start: int, count: int) -> list[tuple[int, str, bool]]:
        """Edges of a shaft that sometimes reverses, with intervals down to the filter time and short glitches."""
        edges: list[tuple[int, str, bool]] = []
        clock, position, direction = start, 0, 1
        levels = {"C3": False, "C4": False}
        while len(edges) < count:
            clock += chance.choice((chance.randrange(1, 40), chance.randrange(40, 400), chance.randrange(400, 3000)))
            if chance.random() < 0.05:
                direction = -direction
            position += direction
            name = ("C4", "C3")[(position + (direction < 0)) % 2]
            if chance.random() < 0.05:  # a glitch shorter than the filter
                edges += [(clock, name, not levels[name]), (clock + 7, name, levels[name])]
                clock += 8
            levels[name] = not levels[name]
            edges.append((clock, name, levels[name]))
        return edges

    def run(self, native: Native, seed: int, filters: dict[str, int], defers_edges: bool) -> tuple[list[Any], int]:
        chance = random.Random(seed)
        rig = ChipRig(native)
        rig.write_all(LINES | timer("A") | filters)
        calls = []

        def handler() -> None:
            calls.append((rig.now, rig.read("TMRA0_CAPT"), rig.read("TMRA1_CAPT")))
            rig.write("TMRA0_SCTRL", 0x08C0)  # IEF stays, IEFIE is off

        rig.handlers[28] = handler
        rig.write("INTC_IPR2", 1 << 6)
        rig.interrupts()
        rig.defers_edges = defers_edges
        rig.edges = self.edges(chance, rig.now, 400)
        end = rig.edges[-1][0] + 100
        seen: list[Any] = []
        while rig.now < end:
            rig.step(chance.randrange(1, 20_000))
            action = chance.random()
            if action < 0.2:
                rig.write("TMRA0_SCTRL", chance.choice((0x00C0, 0x04C0)))  # captures anew, with an interrupt or without
            elif action < 0.3:
                rig.write("TMRA0_CNTR", chance.choice((3990, -3990, 5, 100)))
            elif action < 0.35:
                rig.write("TMRA0_CTRL", chance.choice((0x80A5, 0x80B5)))
            elif action < 0.4:
                rig.write("TMRA0_ENBL", chance.choice((0xF, 0xE)))
            name = chance.choice(WATCHED)
            seen.append((rig.now, name, rig.read(name)))
        seen += [(name, rig.read(name)) for name in WATCHED]
        return [*seen, *calls, *rig.events("capture", "enter")], rig.edges_deferred

    @pytest.mark.parametrize("filters", [FILTERS, {}], ids=["filter", "no filter"])
    def test_deferred_edges_are_counted_like_others(self, registers_c: Native, filters: dict[str, int]) -> None:
        edges_deferred = 0
        for seed in range(20):
            prompt, none = self.run(registers_c, seed, filters, defers_edges=False)
            late, some = self.run(registers_c, seed, filters, defers_edges=True)
            assert late == prompt
            assert none == 0
            edges_deferred += some
        assert edges_deferred > 500  # of 8000

    @staticmethod
    def at(rig: ChipRig, clocks: int, values: dict[str, int]) -> None:
        """Write the registers later in a handler, so that the timers are not accessed before."""

        def handler() -> None:
            rig.write_all(values)
            rig.write("TMRB1_SCTRL", 0)
            rig.write("TMRB1_CTRL", 0)

        rig.handlers[23] = handler
        rig.write("INTC_IPR1", 1 << 12)
        rig.write_all({"TMRB1_COMP1": clocks - 1, "TMRB1_SCTRL": 0x4000, "TMRB1_CTRL": 0x3020})
        rig.interrupts()

    @pytest.mark.parametrize(
        "change", [{"SIM_IPS0": 3 << 8}, {"SIM_GPSCL": 1 << 4 | 1 << 6 | 1 << 8}, {"GPIOC_PER": 0}, {"TMRA0_ENBL": 0}]
    )
    def test_a_reconnected_input_counts_its_edges_until_then(self, registers_c: Native, change: dict[str, int]) -> None:
        counts = []
        for defers_edges in (False, True):
            rig = ChipRig(registers_c)
            rig.write_all(LINES | timer("A") | {f"TMRA{n}_SCTRL": 0 for n in (0, 1, 3)} | {"TMRA0_CNTR": 100})
            rig.defers_edges = defers_edges
            self.at(rig, 5000, change)
            rig.edges = [(rig.now + 300 * n, ("C3", "C4")[n % 2], n % 4 in (0, 1)) for n in range(1, 14)]
            rig.step(6000)
            assert rig.edges_deferred == (13 if defers_edges else 0)
            counts.append(rig.read("TMRA0_CNTR"))
        assert counts[0] == counts[1] != 100

    def test_a_deferred_input_that_becomes_relevant_is_captured(self, registers_c: Native) -> None:
        """C4 is switched from a counter to the crossbar, which connects it to a capturing channel."""
        captures = []
        for defers_edges in (False, True):
            rig = ChipRig(registers_c)
            rig.write_all(LINES | timer("A") | {f"TMRA{n}_SCTRL": 0 for n in (0, 1, 3)} | {"TMRA0_CNTR": 1000})
            rig.write_all({"SIM_IPS0": 1 << 12, "XBARA_SEL17": 8, "TMRB2_CTRL": 0x3E00, "TMRB2_SCTRL": 0x00C0})
            rig.defers_edges = defers_edges
            self.at(rig, 5000, {"SIM_GPSCL": 1 << 4 | 2 << 8})
            rig.clear()
            rig.edges = [(rig.now + 7000, "C4", True)]
            rig.step(20_000)
            captures.append(rig.clocks("capture"))
        assert captures[0] == captures[1] != []

    def test_edges_that_must_not_be_deferred(self, rig: ChipRig, encoder: Encoder) -> None:
        def deferrable() -> int:
            return int(rig.lib.chip_deferrable_edges(rig.chip, pin("C3")))

        rig.write("TMRA0_CNTR", 1000)
        assert deferrable() == 0  # three channels will capture
        encoder.turn(2)
        assert deferrable() == 100
        rig.write("TMRA0_CNTR", 3990)
        assert 0 < deferrable() < 9  # before the compare
        rig.write("TMRA0_CNTR", 1000)
        assert deferrable() == 100
        rig.write("TMRA3_SCTRL", 0x00C0)  # captures again
        assert deferrable() == 0
        encoder.turn(2)
        assert deferrable() == 100
        rig.write("SIM_GPSCL", 1 << 4 | 1 << 6)  # not connected to a timer
        assert deferrable() == 0


@pytest.mark.parametrize("mode", [3, 5, 6])
def test_count_modes_that_are_not_modelled_are_errors(rig: ChipRig, mode: int) -> None:
    with pytest.raises(ChipError, match=r"TMRA1 CTRL = [0-9A-F]{4}h: this count mode is not modelled"):
        rig.write("TMRA1_CTRL", mode << 13 | 0x1E80)


def test_an_output_reaches_an_input_through_its_filter(rig: ChipRig) -> None:
    """OFLAG of TMRB1, toggled after 99 clocks and connected to TB0 by the crossbar, is captured 20 clocks later."""
    rig.write_all({"SIM_IPS0": 0x1000, "XBARA_SEL17": 17, "TMRB0_FILT": 0x0105, "TMRB2_SCTRL": 0x0040})
    rig.write_all({"TMRB2_CTRL": 0x3000, "TMRB1_COMP1": 99, "TMRB1_CTRL": 0x3003})
    start = rig.now
    rig.step(350)
    assert [c - start for c in rig.clocks("capture", a=6)] == [99 + 20]


def test_access_without_clock_is_an_error(rig: ChipRig) -> None:
    rig.write_all(LINES | timer("A"))
    rig.write("SIM_PCE0", 0x7F7F)  # TA0
    with pytest.raises(ChipError, match="TMRA0 CNTR is accessed while its clock is gated off"):
        rig.read("TMRA0_CNTR")
