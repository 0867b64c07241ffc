"""eFlexPWM: counters, double buffering, dead time, faults, synchronisation of the two modules."""

from __future__ import annotations

import pytest
from chip_rig import HALF, PERIOD, PWM_PINS, ChipError, ChipRig, pwm_module, start_pwm
from native_library import Native

OPEN, HIGH, LOW = 0, 1, 2
TRIG_A1 = 22  # VAL4 of PWMA SM1 at the crossbar


def prepare(rig: ChipRig, half: int = 1000, **changes: int) -> int:
    """Start module A as in the reference design; return the clock of the start."""
    rig.write_all(PWM_PINS)
    rig.write_all(pwm_module("A", half, **changes))
    start_pwm(rig, "A")
    rig.clear()
    return rig.now


def gates(rig: ChipRig, start: int, submodule: int = 0) -> list[tuple[int, int]]:
    return [(clock - start, levels) for clock, m, n, levels in rig.gates if (m, n) == (0, submodule)]


def set_duty(rig: ChipRig, half: int, ldok: int = 7) -> None:
    for n in range(3):
        rig.write(f"PWMA{n}_VAL2", -half)
        rig.write(f"PWMA{n}_VAL3", half)
    rig.write("PWMA_MCTRL", 0x0700 | ldok)


class TestCounter:
    def test_counts_from_init_to_val1(self, rig: ChipRig) -> None:
        start = prepare(rig)
        seen = []
        for clock in (0, 1, 3124, 3125, 6249, 6250, 6251, 12500):
            rig.run(start + clock)
            count = rig.read("PWMA0_CNT")
            seen.append(count - 0x10000 if count & 0x8000 else count)
        assert seen == [-3125, -3124, -1, 0, 3124, -3125, -3124, -3125]

    def test_followers_start_with_submodule_0(self, rig: ChipRig) -> None:
        start = prepare(rig)
        rig.run(start + 3 * PERIOD)
        for n in range(3):
            assert [c - start for c in rig.clocks("cycle", a=n)] == [PERIOD, 2 * PERIOD, 3 * PERIOD]

    def test_missed_trigger_occurs_in_the_next_cycle(self, rig: ChipRig) -> None:
        """The trigger is enabled after its count, before any other event of the submodule."""
        start = prepare(rig, PWMA1_VAL4=55)
        rig.run(start + HALF + 200)
        rig.write("PWMA1_TCTRL", 0x10)
        rig.run(start + 2 * PERIOD)
        assert [clock - start for clock in rig.clocks("trigger", a=TRIG_A1)] == [PERIOD + HALF + 55]

    def test_a_follower_without_sync_counts_on(self, rig: ChipRig) -> None:
        """INIT_SEL = EXT_SYNC without that signal: the counter passes VAL1 and wraps after 65536 counts."""
        start = prepare(rig, PWMA1_CTRL2=0x0304)
        rig.run(start + PERIOD + 10)
        assert rig.read("PWMA1_CNT") == HALF + 10
        rig.run(start + 65536 + 5)
        assert rig.read("PWMA1_CNT") == (-HALF + 5) & 0xFFFF
        rig.run(start + 2 * 65536)
        # its outputs switch once per 65536 counts
        assert [clock for clock, levels in gates(rig, start, 1) if levels == HIGH] == [
            HALF - 1000 + 100,
            65536 + HALF - 1000 + 100,
        ]

    def test_the_prescaler_stretches_the_period(self, rig: ChipRig) -> None:
        start = prepare(rig, **{f"PWMA{n}_CTRL": 0x0810 for n in range(3)})
        rig.run(start + 4 * PERIOD)
        assert [c - start for c in rig.clocks("cycle", a=0)] == [2 * PERIOD, 4 * PERIOD]

    def test_the_counter_does_not_run_without_a_load(self, rig: ChipRig) -> None:
        """RUN without LDOK: all values are 0, so a cycle lasts one clock."""
        rig.write_all(PWM_PINS | pwm_module("A"))
        rig.write("PWMA_MCTRL", 0x0700)
        rig.write("PWMA_OUTEN", 0x0770)
        start = rig.now
        rig.clear()
        rig.run(start + 2 * PERIOD)
        assert rig.gates == []
        assert rig.read("PWMA0_CNT") == 0
        rig.write("PWMA_MCTRL", 0x0707)  # every clock is a reload point
        assert rig.read("PWMA_MCTRL") == 0x0700
        begun = rig.now
        rig.run(begun + PERIOD)
        assert [c - begun for c in rig.clocks("cycle", a=0)] == [0, PERIOD]

    def test_a_submodule_without_clock_stops(self, rig: ChipRig) -> None:
        start = prepare(rig)
        rig.run(start + 1000)
        rig.write("SIM_PCE3", 0x00FF & ~(1 << 6))  # PWMA SM1
        rig.run(start + 5 * PERIOD)
        assert gates(rig, start, 1) == []
        assert len(gates(rig, start, 0)) > 8
        with pytest.raises(ChipError, match=r"PWMA SM1 CNT is accessed while its clock is gated off"):
            rig.read("PWMA1_CNT")

    def test_a_wrong_bus_clock_is_refused(self, registers_c: Native) -> None:
        rig = ChipRig(registers_c, start=False)
        rig.write("SIM_PCE3", 0xFF)
        rig.write_all(pwm_module("A"))
        with pytest.raises(ChipError, match=r"a PWM starts while the bus clock is 4\.000 MHz"):
            start_pwm(rig, "A")


class TestEdges:
    def test_centre_aligned_with_dead_time(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + PERIOD)
        rise, fall = HALF - 1000, HALF + 1000
        assert gates(rig, start) == [(rise, OPEN), (rise + 100, HIGH), (fall, OPEN), (fall + 100, LOW)]

    @pytest.mark.parametrize("dead_time", [40, 0])
    def test_dead_time_before_the_upper_switch(self, rig: ChipRig, dead_time: int) -> None:
        start = prepare(rig, 1000, PWMA0_DTCNT0=dead_time)
        rig.run(start + PERIOD)
        highs = [clock for clock, levels in gates(rig, start) if levels == HIGH]
        lows = [clock for clock, levels in gates(rig, start) if levels == LOW]
        assert (highs, lows) == ([HALF - 1000 + dead_time], [HALF + 1000 + 100])
        # without dead time both pins switch in the same clock: no open state in between
        assert ((HALF - 1000, OPEN) in gates(rig, start)) == (dead_time > 0)

    def test_dead_time_before_the_lower_switch(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, PWMA0_DTCNT1=70)
        rig.run(start + PERIOD)
        assert gates(rig, start)[-1] == (HALF + 1000 + 70, LOW)

    def test_a_pulse_shorter_than_the_dead_time_is_lost(self, rig: ChipRig) -> None:
        start = prepare(rig, 30)
        rig.run(start + PERIOD)
        assert gates(rig, start) == [(HALF - 30, OPEN), (HALF + 30 + 100, LOW)]

    def test_the_dead_time_is_7ffh_after_reset(self, rig: ChipRig) -> None:
        values = {k: v for k, v in pwm_module("A", 2500).items() if "DTCNT" not in k}
        rig.write_all(PWM_PINS | values)
        start_pwm(rig, "A")
        start = rig.now
        rig.clear()
        rig.run(start + PERIOD)
        assert (HALF - 2500 + 0x7FF, HIGH) in gates(rig, start)

    def test_full_duty_has_no_edges(self, rig: ChipRig) -> None:
        """VAL3 = VAL1 + 1 is never reached."""
        start = prepare(rig, HALF)
        rig.run(start + 4 * PERIOD)
        assert gates(rig, start) == [(0, OPEN), (100, HIGH)]

    def test_equal_edges_keep_the_output_off(self, rig: ChipRig) -> None:
        start = prepare(rig, 0)
        rig.run(start + 2 * PERIOD)
        assert gates(rig, start) == []

    def test_independent_outputs_switch_at_their_own_values(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, PWMA0_CTRL2=0x2000, PWMA0_VAL4=-500, PWMA0_VAL5=500)
        rig.run(start + PERIOD)
        assert gates(rig, start)[-4:] == [(HALF - 1000, 1), (HALF - 500, 3), (HALF + 500, 1), (HALF + 1000, 0)]

    def test_polarity_inverts_the_outputs(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, PWMA0_OCTRL=0x0600)
        rig.run(start + PERIOD)
        # both switches are on where both should be open
        assert [levels for _, levels in gates(rig, start)] == [3, 2, 3, 1]


class TestLoading:
    def test_a_half_cycle_reload_acts_within_the_pulse(self, rig: ChipRig) -> None:
        """The pulse in progress keeps its old rising edge and takes the new falling edge."""
        start = prepare(rig, 1000)
        rig.run(start + 10)
        set_duty(rig, 500)
        assert rig.read("PWMA_MCTRL") == 0x0707
        rig.run(start + PERIOD)
        assert rig.clocks("load", a=0) == [start + HALF]
        assert rig.read("PWMA_MCTRL") == 0x0700
        assert gates(rig, start) == [
            (HALF - 1000, OPEN),
            (HALF - 1000 + 100, HIGH),
            (HALF + 500, OPEN),
            (HALF + 600, LOW),
        ]

    def test_a_full_cycle_reload_acts_in_the_next_cycle(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, **{f"PWMA{n}_CTRL": 0x0400 for n in range(3)})
        rig.run(start + 10)
        set_duty(rig, 500)
        rig.run(start + 2 * PERIOD)
        assert rig.clocks("load", a=0) == [start + PERIOD]
        assert [clock for clock, levels in gates(rig, start) if levels == OPEN] == [
            HALF - 1000,
            HALF + 1000,
            PERIOD + HALF - 500,
            PERIOD + HALF + 500,
        ]

    def test_values_are_loaded_at_half_and_full_cycle(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, **{f"PWMA{n}_CTRL": 0x0C00 for n in range(3)})
        for clock in (10, HALF + 10):
            rig.run(start + clock)
            set_duty(rig, 500)
        rig.run(start + PERIOD)
        assert rig.clocks("load", a=2) == [start + HALF, start + PERIOD]

    def test_values_can_be_loaded_at_every_second_opportunity(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, PWMA0_CTRL=0x1800)
        rig.run(start + 10)
        set_duty(rig, 500)
        rig.run(start + 2 * PERIOD)
        assert rig.clocks("load", a=0) == [start + PERIOD + HALF]

    def test_without_ldok_nothing_is_loaded(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        rig.write("PWMA0_STS", 0x3000)
        set_duty(rig, 500, ldok=0)
        assert rig.read("PWMA0_STS") & 0x7000 == 0x4000  # RUF
        rig.run(start + PERIOD)
        assert rig.read("PWMA0_STS") & 0x7000 == 0x7000  # RF, REF: changed, and not loaded
        assert gates(rig, start)[2] == (HALF + 1000, OPEN)

    @pytest.mark.parametrize("submodule", [0, 1])
    def test_edges_may_be_exchanged(self, rig: ChipRig, submodule: int) -> None:
        """Pulses before, across and after VAL0, in both directions of change, and with VAL3 before VAL2."""
        start = prepare(rig, 1000)
        pulses = [(500, 2000), (-2000, -500), (0, 800), (-700, 0), (1500, -1500), (-3000, 2900), (-1000, 1000)]
        for k, (on, off) in enumerate(pulses):
            rig.run(start + k * PERIOD + 10)
            rig.write(f"PWMA{submodule}_VAL2", on)
            rig.write(f"PWMA{submodule}_VAL3", off)
            rig.write("PWMA_MCTRL", 0x0707)
            rig.run(start + (k + 1) * PERIOD + HALF)
            rig.clear()
            # loaded at the end of the previous half period, so the following whole period shows it
            rig.write("PWMA_MCTRL", 0x0770)
            rig.run(start + (k + 2) * PERIOD + HALF)
            opened = [(c - start - HALF) % PERIOD for c, m, n, x in rig.gates if (m, n, x) == (0, submodule, OPEN)]
            assert sorted(opened) == sorted({on % PERIOD, off % PERIOD}), (on, off)
            start += 2 * PERIOD

    def test_load_clears_the_update_flag(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        rig.write("PWMA0_STS", 0x3000)
        set_duty(rig, 500)
        rig.run(start + PERIOD)
        assert rig.read("PWMA0_STS") & 0x7000 == 0x1000  # RF alone: no other flag remains

    def test_ldok_can_load_a_single_submodule(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        set_duty(rig, 500, ldok=2)
        rig.run(start + PERIOD)
        assert gates(rig, start, 0)[2] == (HALF + 1000, OPEN)
        assert gates(rig, start, 1)[2] == (HALF + 500, OPEN)

    def test_cldok_cancels_a_pending_load(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        set_duty(rig, 500)
        rig.write("PWMA_MCTRL", 0x0770)
        rig.run(start + PERIOD)
        assert gates(rig, start)[2] == (HALF + 1000, OPEN)

    def test_values_are_locked_while_ldok_is_set(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        set_duty(rig, 500)
        rig.write("PWMA0_VAL3", 700)
        assert rig.read("PWMA0_VAL3") == 500
        assert rig.chip.pwm.module[0].locked_writes == 1
        rig.run(start + PERIOD)
        assert gates(rig, start)[2] == (HALF + 500, OPEN)

    def test_values_can_be_loaded_immediately(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, PWMA0_CTRL=0x0804)
        rig.run(start + 10)
        set_duty(rig, 500)
        assert rig.clocks("load", a=0) == [start + 10]
        assert rig.clocks("load", a=1) == []

    @pytest.mark.parametrize("submodule", [0, 1])
    def test_a_falling_edge_in_the_clock_of_the_reload_is_missed(self, rig: ChipRig, submodule: int) -> None:
        """VAL3 equals the count in which it is loaded: the switch stays on for a whole period."""
        start = prepare(rig, 1000)
        rig.run(start + 10)
        set_duty(rig, 0)
        rig.run(start + 2 * PERIOD)
        openings = [clock for clock, levels in gates(rig, start, submodule) if levels == OPEN]
        assert openings == [HALF - 1000, PERIOD + HALF]

    def test_an_edge_that_is_loaded_behind_the_counter_waits_for_the_next_cycle(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + HALF - 1000)
        for n in range(2):  # VAL2 comes later, but still before the reload at VAL0
            rig.write(f"PWMA{n}_VAL2", -500)
            rig.write(f"PWMA{n}_VAL3", -400)
            rig.write(f"PWMA{n}_TCTRL", 0x000C)
        rig.write("PWMA_MCTRL", 0x0707)
        rig.run(start + 2 * PERIOD)
        for n in range(2):
            assert [c - start for c in rig.clocks("match", a=n, b=2)] == [PERIOD + HALF - 500]
            assert [c - start for c in rig.clocks("match", a=n, b=3)] == [PERIOD + HALF - 400]

    def test_reload_interrupt_and_flag(self, rig: ChipRig) -> None:
        calls = rig.on(86, {"PWMA0_STS": 0x1000})
        start = prepare(rig, 1000, PWMA0_INTEN=0x1000)
        rig.write("INTC_IPR9", 1 << 10)
        rig.interrupts()
        rig.run(start + 2 * PERIOD)
        assert calls == [start + HALF, start + HALF + PERIOD]


class TestForce:
    def test_software_control_waits_for_force(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        rig.write("PWMA_SWCOUT", 0x0002)  # OUT23 of submodule 0
        rig.write("PWMA_DTSRCSEL", 0x0008)  # PWM23 from software
        assert gates(rig, start) == []
        rig.write("PWMA0_CTRL2", 0x0040)
        rig.run(start + PERIOD)
        assert gates(rig, start) == [(10, OPEN), (110, HIGH)]
        assert rig.read("PWMA0_CTRL2") == 0

    def test_the_inverted_source_swaps_the_levels(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        rig.write("PWMA_DTSRCSEL", 0x0004)
        rig.write("PWMA0_CTRL2", 0x0040)
        rig.run(start + PERIOD)
        assert gates(rig, start)[1:4:2] == [(110, HIGH), (HALF - 1000 + 100, LOW)]

    @pytest.mark.parametrize(("mask", "gate_state"), [(0x0010, HIGH), (0x0100, LOW), (0x0110, OPEN)])
    def test_mask_waits_for_force(self, rig: ChipRig, mask: int, gate_state: int) -> None:
        """B or A of submodule 0, or both."""
        start = prepare(rig, 1000)
        rig.run(start + 10)
        rig.write("PWMA_MASK", mask)
        assert gates(rig, start) == []
        rig.write("PWMA0_CTRL2", 0x0040)
        assert (gates(rig, start) == [(10, OPEN)]) == (gate_state != LOW)
        rig.run(start + 3 * PERIOD)
        assert {levels for clock, levels in gates(rig, start) if clock > PERIOD} | {OPEN} == {gate_state, OPEN}

    def test_force_can_begin_the_cycle(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + 10)
        rig.write("PWMA0_CTRL2", 0x10C0)  # FRCEN, PWM23_INIT = 1
        assert rig.read("PWMA0_CNT") == -HALF & 0xFFFF
        rig.run(start + 10 + PERIOD)
        assert gates(rig, start)[:3] == [(10, OPEN), (110, HIGH), (10 + HALF + 1000, OPEN)]

    def test_disabled_outputs_open_immediately(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + HALF)
        rig.write("PWMA_OUTEN", 0)
        assert gates(rig, start)[-1] == (HALF, OPEN)


class TestPins:
    def test_a_wrong_pin_function_keeps_the_switch_off(self, rig: ChipRig) -> None:
        """The pin of a gate driver has another function or is GPIO: its switch stays off."""
        start = prepare(rig, 1000)
        rig.write("SIM_GPSEL", 0xA000 | 1 << 10)  # E5 is XB_IN3: no upper switch of phase c
        rig.write("GPIOE_PER", 0x01FD)  # E1 is GPIO: no upper switch of phase a
        rig.run(start + PERIOD)
        for n in (0, 2):
            assert {levels for _, levels in gates(rig, start, n)} == {OPEN, LOW}
        assert {levels for _, levels in gates(rig, start, 1)} == {OPEN, LOW, HIGH}

    def test_gpio_can_hold_a_gate(self, rig: ChipRig) -> None:
        prepare(rig, 1000)
        rig.write("GPIOE_PER", 0x01FC)
        rig.write("GPIOE_DDR", 0x0002)
        rig.write("GPIOE_DR", 0x0002)
        assert rig.gates[-1][1:] == (0, 0, HIGH)

    def test_a_wrong_pin_selection_disconnects_a_submodule(self, rig: ChipRig) -> None:
        """E6 and E7 carry PWMB 2 only with code 2."""
        rig.write_all(PWM_PINS | pwm_module("B", PWMB0_CTRL2=0, PWMB1_CTRL2=0x0204, PWMB2_CTRL2=0x0204))
        rig.write("SIM_GPSEL", 0)
        start_pwm(rig, "B")
        rig.step(PERIOD)
        assert {n for _, _, n, _ in rig.gates} == {0, 1}


class TestFaults:
    """Comparator of motor 1 on E8, PWMA_FAULT0; high is a fault."""

    def trip(self, rig: ChipRig, fctrl: int = 0xF0F0, fsts: int = 0x00FF, **changes: int) -> int:
        start = prepare(rig, 1000, PWMA_FCTRL0=fctrl, PWMA_FSTS0=fsts, **changes)
        rig.run(start + HALF)
        rig.pin("E8", True)
        return start

    def test_a_fault_opens_the_outputs_without_software(self, rig: ChipRig) -> None:
        start = self.trip(rig)
        assert gates(rig, start)[-1] == (HALF, OPEN)
        assert rig.read("PWMA_FSTS0") & 0x010F == 0x0101
        rig.run(start + 5 * PERIOD)
        assert gates(rig, start)[-1] == (HALF, OPEN)
        rig.clear()
        assert rig.read("PWMB_FSTS0") & 0x000F == 0x000F  # other module: FLVL is 0, so a low level is a fault

    def test_safe_mode_waits_for_flag_and_pin(self, rig: ChipRig) -> None:
        start = self.trip(rig)
        rig.run(start + PERIOD + 10)
        rig.write("PWMA_FSTS0", 0x00F1)
        rig.run(start + 3 * PERIOD + 10)
        assert gates(rig, start)[-1] == (HALF, OPEN)  # the pin is still at its fault level
        rig.pin("E8", False)
        assert gates(rig, start)[-1] == (HALF, OPEN)
        rig.run(start + 4 * PERIOD)
        assert gates(rig, start)[-1] == (4 * PERIOD, LOW)  # the next full cycle

    def test_safe_mode_does_not_resume_with_the_flag(self, rig: ChipRig) -> None:
        start = self.trip(rig)
        rig.run(start + PERIOD)
        rig.pin("E8", False)
        rig.run(start + 5 * PERIOD)
        assert gates(rig, start)[-1] == (HALF, OPEN)

    def test_outputs_resume_at_the_half_cycle(self, rig: ChipRig) -> None:
        start = self.trip(rig, fsts=0xF00F)
        rig.run(start + PERIOD + 10)
        rig.pin("E8", False)
        rig.write("PWMA_FSTS0", 0xF001)
        rig.run(start + PERIOD + HALF)
        assert gates(rig, start)[-1] == (PERIOD + HALF, HIGH)

    def test_outputs_never_resume_without_a_boundary(self, rig: ChipRig) -> None:
        """FFULL and FHALF both 0: the outputs stay off for good."""
        start = self.trip(rig)
        rig.pin("E8", False)
        rig.write("PWMA_FSTS0", 0x0001)
        rig.run(start + 5 * PERIOD)
        assert gates(rig, start)[-1] == (HALF, OPEN)

    def test_normal_mode_resumes_in_spite_of_the_pin(self, rig: ChipRig) -> None:
        start = self.trip(rig, fctrl=0xF000)
        rig.run(start + PERIOD + 10)
        rig.write("PWMA_FSTS0", 0x00F1)
        rig.run(start + 2 * PERIOD)
        assert gates(rig, start)[-1] == (2 * PERIOD, LOW)

    def test_automatic_clearing_follows_the_pin(self, rig: ChipRig) -> None:
        start = self.trip(rig, fctrl=0xFF00)
        rig.run(start + PERIOD + 10)
        rig.pin("E8", False)
        rig.run(start + 2 * PERIOD)
        assert gates(rig, start)[-1] == (2 * PERIOD, LOW)

    def test_outputs_stay_off_with_the_wrong_fault_level(self, rig: ChipRig) -> None:
        """FLVL = 0 although high is the fault level: the outputs are never enabled."""
        start = prepare(rig, 1000, PWMA_FCTRL0=0x00F0)
        rig.run(start + 3 * PERIOD)
        assert rig.gates == []

    def test_a_fault_opens_only_the_mapped_outputs(self, rig: ChipRig) -> None:
        start = self.trip(rig, PWMA0_DISMAP0=0xFF10, PWMA1_DISMAP0=0xFF00)
        # submodule 0: fault 0 opens B only; submodule 1: nothing
        assert gates(rig, start, 0)[-1] != (HALF, OPEN)
        assert gates(rig, start, 2)[-1] == (HALF, OPEN)
        rig.run(start + PERIOD + 200)
        assert gates(rig, start, 0)[-1] == (HALF + 1000, OPEN)
        assert gates(rig, start, 1)[-1] == (HALF + 1100, LOW)

    def test_the_filter_ignores_short_pulses(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000, PWMA_FFILT0=0x0205)  # five samples, five clocks apart
        rig.run(start + HALF)
        rig.edges = [(start + HALF, "E8", True), (start + HALF + 24, "E8", False), (start + HALF + 100, "E8", True)]
        rig.run(start + HALF + 130)
        assert gates(rig, start)[-1] == (HALF + 125, OPEN)

    def test_a_fault_calls_its_handler(self, rig: ChipRig) -> None:
        calls = rig.on(77, {"PWMA_FCTRL0": 0xF0F0})
        rig.write("INTC_IPR8", 3 << 8)
        start = self.trip(rig, fctrl=0xF0F1)
        rig.interrupts()
        rig.step(10)
        assert calls == [start + HALF]

    def test_a_simulated_fault_opens_the_outputs(self, rig: ChipRig) -> None:
        start = prepare(rig)
        rig.run(start + HALF)
        rig.write("PWMA_FTST0", 1)
        assert gates(rig, start)[-1] == (HALF, OPEN)

    def test_a_fault_acts_while_nothing_counts(self, rig: ChipRig) -> None:
        start = prepare(rig, 1000)
        rig.run(start + HALF)
        rig.write("PWMA_MCTRL", 0)
        rig.pin("E8", True)
        assert gates(rig, start)[-1] == (HALF, OPEN)


def both(rig: ChipRig, **changes: int) -> int:
    """Both modules; B is synchronised by VAL0 of A through crossbar A."""
    rig.write_all(PWM_PINS)
    values = pwm_module("A") | pwm_module("B") | {
        "PWMA0_TCTRL": 1, "XBARA_SEL26": 0x1400, "XBARA_SEL27": 0x1414,
    }  # fmt: skip
    rig.write_all(values | changes)
    start_pwm(rig, "B")
    rig.step(777)
    start_pwm(rig, "A")
    start = rig.now
    rig.run(start + 2 * PERIOD)
    rig.clear()
    rig.run(start + 4 * PERIOD)
    return start


def phase(rig: ChipRig) -> float:
    """Cycle of module B after that of A [clocks]."""
    a, b = rig.clocks("cycle", a=0)[0], rig.clocks("cycle", a=4)
    return next(c for c in b if c > a) - a


class TestTwoModules:
    @pytest.mark.parametrize("latency", [0, 2, 5])
    def test_the_modules_are_half_a_period_apart(self, registers_c: Native, latency: int) -> None:
        rig = ChipRig(registers_c, crossbar_clocks=latency)
        both(rig)
        assert phase(rig) == HALF + 1 + latency
        assert rig.clocks("cycle", a=4) == rig.clocks("cycle", a=5) == rig.clocks("cycle", a=6)

    def test_val0_sets_the_phase(self, rig: ChipRig) -> None:
        both(rig, PWMA0_VAL0=-1000)
        assert phase(rig) == HALF - 1000 + 1

    def test_followers_can_use_the_master_sync_of_submodule_0(self, rig: ChipRig) -> None:
        both(rig, PWMB1_CTRL2=0x0204, PWMB2_CTRL2=0x0204)
        assert rig.clocks("cycle", a=4) == rig.clocks("cycle", a=5) == rig.clocks("cycle", a=6)

    @pytest.mark.parametrize(
        "broken",
        [
            {"XBARA_SEL26": 0x1500},  # TRIG1 instead of TRIG0
            {"PWMA0_TCTRL": 0},  # no trigger
            {"PWMA0_TCTRL": 2},  # of VAL1
        ],
    )
    def test_module_b_drifts_without_the_trigger(self, rig: ChipRig, broken: dict[str, int]) -> None:
        both(rig, **broken)
        assert rig.clocks("cycle", a=4) == []

    def test_own_sync_keeps_the_phase_of_the_start(self, rig: ChipRig) -> None:
        """INIT_SEL of B selects its own VAL1: same frequency, arbitrary phase."""
        both(rig, PWMB0_CTRL2=0, PWMB1_CTRL2=0x0204, PWMB2_CTRL2=0x0204)
        assert phase(rig) == PERIOD - 777 % PERIOD


def test_compare_flags_are_cleared_by_writing_one(rig: ChipRig) -> None:
    start = prepare(rig, 1000)
    rig.run(start + HALF - 500)
    # INIT + 100 (VAL4), INIT + 400 (VAL5) and VAL2 have passed; VAL0, VAL1 and VAL3 have not
    assert rig.read("PWMA0_STS") & 0x3F == 0b110100
    rig.write("PWMA0_STS", 0x0010)
    assert rig.read("PWMA0_STS") & 0x3F == 0b100100
    rig.run(start + PERIOD - 1)
    assert rig.read("PWMA0_STS") & 0x3F == 0b101111
    rig.run(start + PERIOD + 100)
    assert rig.read("PWMA0_STS") & 0x3F == 0b111111


def test_a_compare_enabled_after_its_count_occurs_in_the_next_cycle(rig: ChipRig) -> None:
    start = prepare(rig)
    rig.run(start + 1000)
    rig.write("PWMA1_TCTRL", 0x0010)
    rig.run(start + 1001)
    assert rig.now == start + 1001
    rig.run(start + PERIOD + 1000)
    assert [c - start for c in rig.clocks("match", a=1, b=4)] == [PERIOD + 100]


def test_a_compare_event_calls_its_handler_every_period(rig: ChipRig) -> None:
    calls = rig.on(85, {"PWMA1_STS": 0x0020})
    rig.write("INTC_IPR9", 2 << 8)
    rig.interrupts()
    start = prepare(rig, 1000, PWMA1_INTEN=0x0020)
    rig.run(start + 2 * PERIOD)
    assert calls == [start + 400, start + PERIOD + 400]


@pytest.mark.parametrize(
    ("register", "value"),
    [
        ("PWMA0_FRACVAL1", 1),
        ("PWMA0_FRCTRL", 2),
        ("PWMA0_CTRL2", 0x0001),
        ("PWMA0_CTRL2", 0x0200),
        ("PWMA1_CTRL2", 0x0038),
        ("PWMA0_CTRL", 0x0401),
        ("PWMA0_DMAEN", 1),
        ("PWMA0_TCTRL", 0x8000),
        ("PWMA_DTSRCSEL", 3),
        ("PWMA_OUTEN", 1),
    ],
)
def test_error_of_an_unmodelled_function_names_register_value_and_time(rig: ChipRig, register: str, value: int) -> None:
    letter, name = register.split("_")
    spoken = f"PWMA SM{letter[4]} {name}" if len(letter) == 5 else f"PWMA {name}"
    with pytest.raises(ChipError, match=rf"^{spoken} = {value:04X}h: .* \(at \d+\.\d\d us\)$"):
        rig.write(register, value)
