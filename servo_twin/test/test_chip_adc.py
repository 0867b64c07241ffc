"""12-bit ADC: triggered parallel scans with a pause, through crossbars and AOI, as in the reference design."""

from __future__ import annotations

from itertools import pairwise

import pytest
from chip_rig import HALF, PERIOD, PWM_PINS, ChipError, ChipRig, pwm_module, start_pwm

ADC_CLOCK = 5
"""Bus clocks: 20 MHz."""
FIRST, FURTHER = 43, 30
"""8.5 and 6 ADC clocks, in bus clocks."""
HOLD = 13
"""Sample held 2.5 ADC clocks after the start."""

CONFIGURE = {
    "GPIOA_PER": 0xFF, "GPIOB_PER": 0xFF, "ADC_PWR2": 0x040F, "ADC_CTRL1": 0x5005, "ADC_CTRL2": 0x4044,
    "ADC_CLIST1": 0x3210, "ADC_CLIST2": 0x7654, "ADC_CLIST3": 0xBA98, "ADC_CLIST4": 0xFEDC, "ADC_SDIS": 0xC0C0,
    "ADC_SCTRL": 0x0008, "ADC_PWR": 0x01A0, "ADC_STAT": 0x1800, "ADC_CTRL2 ": 0x0044,
}  # fmt: skip
TRIGGERS = {
    "XBARB_SEL0": 0x1609, "AOI_BFCRT01_0": 0x7FDF, "AOI_BFCRT23_0": 0, "XBARA_SEL6": 0x2E2E, "PWMA0_TCTRL": 1,
    "XBARA_SEL26": 0x1400, "XBARA_SEL27": 0x1414, "PWMA1_TCTRL": 0x10, "PWMB0_TCTRL": 0x10,
}  # fmt: skip


def configure(rig: ChipRig, arm: int = 0x1005, **changes: int) -> None:
    for name, value in (CONFIGURE | changes).items():
        rig.write(name.strip(), value)
    rig.step(200)  # power-up delay
    rig.write("ADC_CTRL1", arm)


def run_triggered(rig: ChipRig, periods: int = 4, **changes: int) -> int:
    """Start both carriers and arm the ADC just after motor 2's trigger; return the clock of motor 1's next trigger."""
    rig.write_all(PWM_PINS | pwm_module("A") | pwm_module("B") | {
        k: v for k, v in (TRIGGERS | changes).items() if not k.startswith("ADC")
    })  # fmt: skip
    start_pwm(rig, "B")
    start_pwm(rig, "A")
    start = rig.now
    rig.run(start + 2 * PERIOD + HALF + 200)
    configure(rig, **{k: v for k, v in changes.items() if k.startswith("ADC")})
    rig.clear()
    rig.run(start + (3 + periods) * PERIOD)
    return start + 3 * PERIOD + 100


def samples(rig: ChipRig, origin: int) -> list[tuple[int, int]]:
    """(Clock, sample) of converter A."""
    return [(e.clock - origin, e.a) for e in rig.events("sample") if e.a < 8]


def align(clock: int) -> int:
    return -(-clock // ADC_CLOCK) * ADC_CLOCK


def test_three_pairs_each_half_period(rig: ChipRig) -> None:
    """DRM F35: three pairs at t0, a pause, three at t2, and so on."""
    t0 = run_triggered(rig)
    expected = []
    for k in range(4):
        for first, trigger in ((0, t0 + k * PERIOD), (3, t0 + k * PERIOD + HALF + 1)):
            begin = align(trigger) + HOLD
            expected += [(begin + i * FURTHER - t0, first + i) for i in range(3)]
    assert samples(rig, t0)[:24] == expected
    pairs = [(e.clock, e.a) for e in rig.events("sample")]
    assert all((clock, a + 8) in pairs for clock, a in pairs if a < 8)  # both converters together
    ends = rig.clocks("scan_end")
    assert [end - t0 for end in ends[:2]] == [
        align(t0 + k * PERIOD + HALF + 1) + FIRST + 2 * FURTHER - t0 for k in range(2)
    ]


@pytest.mark.parametrize(("disabled", "pairs"), [(0xC0C0, 6), (0xE0C0, 5), (0xC0E0, 5), (0x0000, 8), (0x0202, 1)])
def test_the_scan_ends_at_the_first_disabled_sample_of_either(rig: ChipRig, disabled: int, pairs: int) -> None:
    configure(rig, arm=0x5005, ADC_SDIS=disabled, ADC_SCTRL=0)
    rig.clear()
    rig.write("ADC_CTRL1", 0x2001)
    rig.step(1000)
    assert len(rig.events("sample")) == 2 * pairs
    assert len(rig.events("scan_end")) == 1


def test_times_of_the_data_sheet(rig: ChipRig) -> None:
    """Eight results of four pairs take 26.5 ADC clocks, further ones 6 per pair."""
    configure(rig, arm=0x5005, ADC_SDIS=0xF0F0, ADC_SCTRL=0)
    rig.clear()
    rig.write("ADC_CTRL1", 0x2001)  # once, parallel, started by software
    begin = align(rig.now)
    rig.step(1000)
    assert rig.clocks("scan_end") == [begin + round(26.5 * ADC_CLOCK + 0.5)]
    assert rig.clocks("sample", a=3) == [begin + HOLD + 3 * FURTHER]


def test_result_alignment_and_offset(rig: ChipRig) -> None:
    rig.codes = [2048 + 10 * k for k in range(16)]
    configure(rig, arm=0x5005, ADC_SCTRL=0, ADC_OFFST1=0x4000, ADC_OFFST9=0x4000 + 8 * 200)
    rig.write("ADC_CTRL1", 0x2001)
    rig.step(1000)
    assert rig.read("ADC_RSLT0") == 2048 * 8
    assert rig.read("ADC_RSLT1") == 10 * 8
    assert rig.read("ADC_RSLT9") == (-110 * 8) & 0xFFFF  # sign in bit 15
    assert rig.read("ADC_RSLT13") == (2048 + 130) * 8


def test_ready_flags_are_cleared_by_reading(rig: ChipRig) -> None:
    configure(rig, arm=0x5005, ADC_SCTRL=0)
    rig.write("ADC_CTRL1", 0x2001)
    begin = align(rig.now)
    assert rig.read("ADC_STAT") & 0xC000 == 0xC000
    rig.run(begin + FIRST - 1)
    assert rig.read("ADC_RDY") == 0
    rig.run(begin + FIRST)
    assert rig.read("ADC_RDY") == 0x0101
    rig.step(1000)
    assert rig.read("ADC_RDY") == 0x3F3F
    rig.read("ADC_RSLT8")
    assert rig.read("ADC_RDY") == 0x3E3F
    assert rig.read("ADC_STAT") & 0xD800 == 0x0800


def test_a_result_read_too_early_is_the_old_one(rig: ChipRig) -> None:
    """VAL5 follows VAL4 before three conversions have ended: the third pair still has the result of the last period."""
    rig.codes[6] = lambda clock: clock // PERIOD % 4096
    read: list[tuple[int, int]] = []

    def m1() -> None:
        read.append((rig.now, rig.read("ADC_RSLT2") // 8))
        rig.write("PWMA1_STS", 0x20)

    rig.handlers[85] = m1
    rig.write("INTC_IPR9", 2 << 8)
    rig.interrupts()
    three = FIRST + 2 * FURTHER
    for val5, late in ((-HALF + 100 + three + 5, 0), (-HALF + 100 + three - 10, 1)):
        run_triggered(rig, PWMA1_INTEN=0x20, PWMA1_VAL5=val5, ADC_CLIST1=0x3610)
        held = [e.clock for e in rig.events("sample") if e.a == 2]
        clock, value = read[-1]
        assert value == [c // PERIOD % 4096 for c in held if c <= clock][-1 - late]
        for letter in "AB":
            rig.write(f"PWM{letter}_MCTRL", 0)
        rig.write("ADC_CTRL1", 0x5005)


class TestPhaseOfTheSamples:
    def test_the_first_sample_follows_the_trigger_value(self, rig: ChipRig) -> None:
        t0 = run_triggered(rig, PWMA1_VAL4=-HALF + 1000)
        assert samples(rig, t0)[0] == (align(t0 + 900) + HOLD - t0, 0)

    def test_without_a_pause_one_trigger_takes_all_six(self, rig: ChipRig) -> None:
        t0 = run_triggered(rig, ADC_SCTRL=0)
        taken = samples(rig, t0)
        assert [a for _, a in taken[:12]] == [0, 1, 2, 3, 4, 5] * 2
        assert taken[6][0] - taken[0][0] == align(t0 + HALF + 1) - align(t0)  # motor 2 has its own scan

    def test_the_pause_can_precede_another_pair(self, rig: ChipRig) -> None:
        t0 = run_triggered(rig, ADC_SCTRL=0x0004)
        taken = samples(rig, t0)
        assert [a for clock, a in taken if clock < HALF] == [0, 1]
        assert [a for clock, a in taken if HALF < clock < PERIOD] == [2, 3, 4, 5]

    @pytest.mark.parametrize(
        "broken", [{"PWMB0_TCTRL": 0}, {"XBARB_SEL0": 0x0009}, {"AOI_BFCRT01_0": 0x7F00}, {"PWMB0_TCTRL": 0x20}]
    )
    def test_a_wrong_trigger_of_motor_2_shifts_the_samples(self, rig: ChipRig, broken: dict[str, int]) -> None:
        """The second half of the scan comes with motor 1's trigger, a period late, at the wrong instant."""
        t0 = run_triggered(rig, **broken)
        taken = samples(rig, t0)
        if broken.get("PWMB0_TCTRL") == 0x20:
            # VAL5 triggers the same line, and it is the first trigger after the ADC was armed: the motors are swapped
            assert [a for clock, a in taken if HALF + 300 < clock < PERIOD] == [0, 1, 2]
            return
        assert [a for clock, a in taken if clock < PERIOD - 10] == [0, 1, 2]
        assert [a for clock, a in taken if PERIOD - 10 < clock < 2 * PERIOD - 10] == [3, 4, 5]

    @pytest.mark.parametrize("broken", [{"XBARA_SEL6": 0}, {"XBARA_SEL6": 0x2E00}, {"ADC_CTRL1": 0x0005}])
    def test_a_missing_sync_causes_no_scan(self, rig: ChipRig, broken: dict[str, int]) -> None:
        changes = {k: v for k, v in broken.items() if k != "ADC_CTRL1"}
        if "ADC_CTRL1" in broken:
            run_triggered(rig)
            rig.write("ADC_CTRL1", 0x5005)
            rig.write("ADC_CTRL1", broken["ADC_CTRL1"])
            rig.clear()
            rig.step(3 * PERIOD)
        else:
            run_triggered(rig, **changes)
        assert rig.events("sample") == []

    def test_triggers_connected_by_and_cause_no_scan(self, rig: ChipRig) -> None:
        run_triggered(rig, AOI_BFCRT01_0=0x5F00)  # A and B
        assert rig.events("sample") == []

    def test_arming_in_the_wrong_half_period_swaps_the_motors(self, rig: ChipRig) -> None:
        t0 = run_triggered(rig)
        rig.write("ADC_CTRL1", 0x5005)
        now = rig.now - t0
        rig.step((HALF - 500 - now) % PERIOD)  # between motor 1's trigger and motor 2's
        rig.write("ADC_CTRL1", 0x1005)
        rig.clear()
        rig.step(2 * PERIOD)
        assert [a for _, a in samples(rig, t0)[:3]] == [0, 1, 2]
        assert (samples(rig, t0)[0][0]) % PERIOD > HALF

    def test_a_trigger_during_conversion_is_ignored(self, rig: ChipRig) -> None:
        t0 = run_triggered(rig, PWMA1_TCTRL=0x30, PWMA1_VAL5=-HALF + 140)
        obeyed = [e.b for e in rig.events("sync")]
        assert obeyed.count(0) > 0
        assert [a for clock, a in samples(rig, t0) if clock < HALF] == [0, 1, 2]


class TestScanEnd:
    def test_interrupt_and_clear(self, rig: ChipRig) -> None:
        calls = []

        def m2() -> int:
            calls.append(rig.now)
            rig.write("ADC_STAT", 0x0800)
            return 500

        rig.handlers[30] = m2
        rig.write("INTC_IPR2", 2 << 10)
        rig.interrupts()
        run_triggered(rig, ADC_CTRL1=0x5005)
        rig.write("ADC_CTRL1", 0x5805)
        rig.write("ADC_CTRL1", 0x1805)
        rig.step(0)
        calls.clear()
        rig.clear()
        rig.step(3 * PERIOD)
        assert calls[0] in rig.clocks("scan_end")
        assert [b - a for a, b in pairwise(calls)] == [PERIOD] * (len(calls) - 1)

    def test_uncleared_flag_blocks_lower_priorities(self, rig: ChipRig) -> None:
        rig.handlers[30] = lambda: 500
        rig.write("INTC_IPR2", 2 << 10)
        rig.interrupts()
        run_triggered(rig)
        rig.write("ADC_CTRL1", 0x5805)
        rig.clear()
        rig.step(5000)
        enters, leaves = rig.clocks("enter"), rig.clocks("leave")
        assert len(enters) >= 10
        assert enters[1:] == leaves[: len(enters) - 1]  # repeated without a gap

    def test_a_sample_calls_its_handler_once(self, rig: ChipRig) -> None:
        """SCHLTEN requests the interrupt after sample 9 until its result is read."""
        calls = []

        def handler() -> None:
            calls.append(rig.now)
            rig.read("ADC_RSLT9")

        rig.handlers[30] = handler
        rig.write("INTC_IPR2", 2 << 10)
        rig.interrupts()
        configure(rig, arm=0x5005, ADC_SCTRL=0, ADC_SCHLTEN=1 << 9)
        rig.write("ADC_CTRL1", 0x2001)
        begin = align(rig.now)
        rig.step(1000)
        assert calls == [begin + FIRST + FURTHER]


class TestConditions:
    def test_a_converter_without_power_takes_no_sample(self, rig: ChipRig) -> None:
        run_triggered(rig, ADC_PWR=0x01A7)
        assert rig.events("sample") == []
        assert rig.read("ADC_PWR") & 0x0C00 == 0x0C00

    def test_power_up_takes_its_time(self, rig: ChipRig) -> None:
        assert rig.read("ADC_PWR") == 0x1DA7
        rig.write("ADC_CTRL2", 0x4044)
        rig.write("ADC_PWR", 0x01A4)
        rig.step(26 * ADC_CLOCK - 1)
        assert rig.read("ADC_PWR") & 0x0C00 == 0x0C00
        rig.step(1)
        assert rig.read("ADC_PWR") & 0x0C00 == 0

    def test_a_converter_without_clock_takes_no_sample(self, rig: ChipRig) -> None:
        run_triggered(rig)
        rig.clear()
        rig.write("SIM_PCE2", 0)
        rig.step(2 * PERIOD)
        assert rig.events("sample") == []
        with pytest.raises(ChipError, match=r"ADC RSLT3 is accessed while its clock is gated off \(SIM_PCE2 bit 7\)"):
            rig.read("ADC_RSLT3")

    def test_an_analogue_pin_used_as_gpio_reads_zero(self, rig: ChipRig) -> None:
        rig.codes = [1000] * 16
        configure(rig, arm=0x5005, ADC_SCTRL=0, GPIOA_PER=0xFE)
        rig.write("ADC_CTRL1", 0x2001)
        rig.step(1000)
        assert [rig.read(f"ADC_RSLT{n}") // 8 for n in (0, 1, 8)] == [0, 1000, 1000]

    def test_channels_are_taken_from_the_list(self, rig: ChipRig) -> None:
        configure(rig, arm=0x5005, ADC_SCTRL=0, ADC_CLIST1=0x0123, ADC_CLIST3=0x89AB)
        rig.write("ADC_CTRL1", 0x2001)
        rig.step(1000)
        assert [rig.read(f"ADC_RSLT{n}") // 8 for n in (0, 3, 8, 11)] == [300, 0, 1100, 800]

    def test_an_input_of_the_other_converter_is_an_error(self, rig: ChipRig) -> None:
        configure(rig, arm=0x5005, ADC_CLIST1=0x3218)
        rig.write("ADC_CTRL1", 0x2001)
        with pytest.raises(ChipError, match="sample 0 of converter A takes an input of the other one"):
            rig.step(1000)

    def test_a_clock_too_fast_for_the_speed_code_is_an_error(self, rig: ChipRig) -> None:
        configure(rig, arm=0x5005, ADC_PWR2=0x0400)
        with pytest.raises(ChipError, match="a clock of 20 MHz with SPEEDA = 0"):
            rig.write("ADC_CTRL1", 0x2001)

    def test_a_slower_clock_lengthens_the_scan(self, rig: ChipRig) -> None:
        configure(rig, arm=0x5005, ADC_SDIS=0xF0F0, ADC_SCTRL=0)
        rig.write("ADC_CTRL2", 0x0049)  # / 10
        rig.clear()
        rig.write("ADC_CTRL1", 0x2001)
        begin = -(-rig.now // 10) * 10
        rig.step(1000)
        assert rig.clocks("scan_end") == [begin + 265]

    def test_independent_converters_end_their_own_scans(self, rig: ChipRig) -> None:
        """SIMULT = 0: converter B has its own SYNC, divider and end of scan."""
        configure(rig, arm=0x5005, ADC_SDIS=0xF0F0, ADC_SCTRL=0)
        rig.write("ADC_CTRL2", 0x2004)  # START1
        begin = align(rig.now)
        rig.clear()
        rig.step(1000)
        assert {e.a for e in rig.events("sample")} == {8, 9, 10, 11}
        assert rig.clocks("scan_end", a=1) == [begin + 133]
        assert rig.read("ADC_STAT") & 0x1800 == 0x1000


def test_a_scan_without_samples_is_an_error(rig: ChipRig) -> None:
    configure(rig, arm=0x5005, ADC_SDIS=0x0100)
    with pytest.raises(ChipError, match=r"a scan without samples \(SDIS = 0100h\)"):
        rig.write("ADC_CTRL1", 0x2001)


@pytest.mark.parametrize(
    ("register", "value", "spoken"),
    [
        ("ADC_CTRL1", 0x1004, "ADC CTRL1 = 1004h: only parallel scans"),
        ("ADC_CTRL1", 0x5015, "ADC CTRL1 = 5015h: differential"),
        ("ADC_SCTRL", 0x0010, "ADC SCTRL = 0010h: .*sources disagree"),
        ("ADC_GC1", 1, "ADC GC1 = 0001h"),
        ("ADC_CTRL3", 1, "ADC CTRL3 = 0001h"),
        ("ADC_CAL", 0x1000, "ADC CAL = 1000h"),
    ],
)
def test_unmodelled_settings_raise_an_error(rig: ChipRig, register: str, value: int, spoken: str) -> None:
    with pytest.raises(ChipError, match=spoken):
        rig.write(register, value)
