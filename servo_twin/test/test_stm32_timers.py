"""Timers of the STM32F405: centre-aligned PWM, dead time, preload, break, encoder mode, captures, triggers."""

from __future__ import annotations

import pytest
from stm32_rig import ARR, MS, PERIOD, Stm32Error, Stm32Rig

HIGH, LOW = 1, 2
PWM1, PWM2 = 0x68, 0x78  # with preload
GATE_PINS = {
    1: {"A8": 1, "A9": 1, "A10": 1, "B13": 1, "B14": 1, "B15": 1},
    8: {"C6": 3, "C7": 3, "C8": 3, "A7": 3, "B0": 3, "B1": 3},
}
MOE, AOE, OSSR_OSSI = 0x8000, 0x4000, 0x0C00


def set_up(rig: Stm32Rig, n: int, mode: int = PWM1, dead_time: int = 84, rcr: int = 0) -> None:
    """Inverter timer, 16 kHz, outputs off; not started."""
    for name, number in GATE_PINS[n].items():
        rig.function(name, number)
    tim = f"TIM{n}_"
    rig.write_all(
        {
            f"{tim}CR1": 0xE0,  # centre-aligned 3, ARPE
            f"{tim}ARR": ARR,
            f"{tim}RCR": rcr,
            f"{tim}CCMR1": mode | mode << 8,
            f"{tim}CCMR2": mode,
            f"{tim}CCER": 0x555,
            f"{tim}BDTR": OSSR_OSSI | dead_time,
        }
    )


def duties(rig: Stm32Rig, n: int, *values: int) -> None:
    for k, value in enumerate(values):
        rig.write(f"TIM{n}_CCR{k + 1}", value)


def start(rig: Stm32Rig, n: int) -> int:
    """Load the buffers and start; the clock of the start."""
    rig.write(f"TIM{n}_EGR", 1)
    rig.write(f"TIM{n}_SR", 0)
    rig.set_bits(f"TIM{n}_CR1", 1)
    return rig.now


def drivers_on(rig: Stm32Rig) -> None:
    """EN_GATE high, and its 10 ms."""
    rig.mode("B12", 1)
    rig.write("GPIOB_BSRR", 1 << 12)
    rig.step(11 * MS)


def of(rig: Stm32Rig, axis: int, phase: int, begin: int) -> list[tuple[int, int]]:
    """Changes of a leg, with clocks from the start of the counter."""
    return [(clock - begin, levels) for clock, a, p, levels in rig.gates if (a, p) == (axis, phase)]


# ---- PWM ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "mode", "centre"), [(1, PWM1, 0), (8, PWM2, ARR)])
def test_pulses_lie_around_their_centre(stm32: Stm32Rig, n: int, mode: int, centre: int) -> None:
    """Mode 1 is high around 0, mode 2 around ARR; each edge that closes a switch comes a dead time later."""
    drivers_on(stm32)
    set_up(stm32, n, mode, dead_time=84)
    width = 2000
    duties(stm32, n, width if mode == PWM1 else ARR - width)
    begin = start(stm32, n)
    stm32.set_bits(f"TIM{n}_BDTR", MOE)
    stm32.step(PERIOD)
    stm32.clear()
    stm32.step(PERIOD)
    rise = begin + PERIOD + (centre - width) % PERIOD
    fall = begin + PERIOD + (centre + width) % PERIOD
    axis = 0 if n == 1 else 1
    edges = sorted([(rise, 0), (rise + 84, HIGH), (fall, 0), (fall + 84, LOW)])
    assert [(clock, levels) for clock, a, phase, levels in stm32.gates if (a, phase) == (axis, 0)] == edges


@pytest.mark.parametrize(
    ("code", "clocks"), [(0, 0), (127, 127), (0x80, 128), (0x94, 168), (0xC0, 256), (0xE0, 512), (0xFF, 1008)]
)
def test_dead_time_codes(stm32: Stm32Rig, code: int, clocks: int) -> None:
    drivers_on(stm32)
    set_up(stm32, 1, dead_time=code)
    duties(stm32, 1, 2000)
    begin = start(stm32, 1)
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.clear()
    stm32.step(PERIOD)
    edges = [edge for edge in of(stm32, 0, 0, begin) if edge[0] >= 2000]
    assert edges == [
        *([(2000, 0)] if clocks else []),
        (2000 + clocks, LOW),
        *([(PERIOD - 2000, 0)] if clocks else []),
        (PERIOD - 2000 + clocks, HIGH),
    ]


def test_a_pulse_shorter_than_the_dead_time_vanishes(stm32: Stm32Rig) -> None:
    drivers_on(stm32)
    set_up(stm32, 1, dead_time=84)
    duties(stm32, 1, 40)  # 80 clocks
    start(stm32, 1)
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.step(PERIOD)
    stm32.clear()
    stm32.step(2 * PERIOD)
    assert {levels for _, _, phase, levels in stm32.gates if phase == 0} == {0, LOW}


def test_full_and_no_duty(stm32: Stm32Rig) -> None:
    drivers_on(stm32)
    set_up(stm32, 1)
    duties(stm32, 1, 0, ARR, ARR + 1)
    start(stm32, 1)
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.step(PERIOD)
    last = {phase: levels for _, _, phase, levels in stm32.gates}
    stm32.clear()
    stm32.step(3 * PERIOD)
    assert last == {0: LOW, 1: HIGH, 2: HIGH}
    assert stm32.gates == []


@pytest.mark.parametrize(("rcr", "loads"), [(0, (ARR, 2 * ARR)), (1, (2 * ARR, 4 * ARR))])
def test_preloaded_duties_are_loaded_by_update_events(stm32: Stm32Rig, rcr: int, loads: tuple[int, int]) -> None:
    """RCR 0: at each overflow and underflow. RCR 1, loaded by UG before the start: at underflows."""
    set_up(stm32, 1, rcr=rcr)
    begin = start(stm32, 1)
    seen: list[int] = []
    while len(seen) < 2:
        stm32.step(10)
        if stm32.read("TIM1_SR") & 1:
            stm32.write("TIM1_SR", 0)
            seen.append(stm32.now - begin)
    assert seen == [*loads]


def test_a_new_duty_waits_for_the_update(stm32: Stm32Rig) -> None:
    """Written behind the low-side centre, the overflow, it acts from the underflow on."""
    drivers_on(stm32)
    set_up(stm32, 1, dead_time=0)
    duties(stm32, 1, 1000)
    begin = start(stm32, 1)
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.run(begin + ARR + 500)
    stm32.write("TIM1_CCR1", 3000)
    stm32.run(begin + 2 * PERIOD)
    assert of(stm32, 0, 0, begin)[2:] == [
        (PERIOD - 1000, HIGH),  # still the old one
        (PERIOD + 3000, LOW),
        (2 * PERIOD - 3000, HIGH),
    ]


def test_without_preload_a_compare_acts_at_once(stm32: Stm32Rig) -> None:
    drivers_on(stm32)
    set_up(stm32, 1, mode=0x60, dead_time=0)
    duties(stm32, 1, 1000)
    begin = start(stm32, 1)
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.run(begin + 1500)
    stm32.write("TIM1_CCR1", 2000)
    stm32.run(begin + 2500)
    assert of(stm32, 0, 0, begin)[-3:] == [(1000, LOW), (1500, HIGH), (2000, LOW)]


# ---- enabling -------------------------------------------------------------------------------------------------------


def test_outputs_are_open_without_moe(stm32: Stm32Rig) -> None:
    drivers_on(stm32)
    set_up(stm32, 1)
    duties(stm32, 1, 2000, 2000, 2000)
    start(stm32, 1)
    stm32.step(PERIOD)
    assert stm32.gates == []
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.step(PERIOD)
    stm32.write("TIM1_BDTR", stm32.read("TIM1_BDTR") & ~MOE)
    assert {levels for _, _, _, levels in stm32.gates[-3:]} == {0}
    stm32.clear()
    stm32.step(PERIOD)
    assert stm32.gates == []


def test_automatic_output_enable_waits_for_an_update(stm32: Stm32Rig) -> None:
    set_up(stm32, 1)
    begin = start(stm32, 1)
    stm32.run(begin + 100)
    stm32.set_bits("TIM1_BDTR", AOE)
    stm32.run(begin + ARR - 1)
    assert not stm32.read("TIM1_BDTR") & MOE
    stm32.run(begin + ARR)
    assert stm32.read("TIM1_BDTR") & MOE


def test_a_break_by_software_opens_the_bridge(stm32: Stm32Rig) -> None:
    set_up(stm32, 8)
    stm32.set_bits("TIM8_BDTR", MOE)
    stm32.write("TIM8_DIER", 0x80)
    stm32.write("TIM8_EGR", 0x80)
    assert not stm32.read("TIM8_BDTR") & MOE
    assert stm32.requested(43)
    stm32.write("TIM8_SR", 0)
    assert not stm32.requested(43)


def test_locked_dead_time_stays(stm32: Stm32Rig) -> None:
    stm32.write("TIM1_BDTR", 0x0154)  # lock level 1
    stm32.write("TIM1_BDTR", 0x0020 | MOE)
    assert stm32.read("TIM1_BDTR") == 0x0154 | MOE


def test_disabled_gate_drivers_open_the_bridge(stm32: Stm32Rig) -> None:
    set_up(stm32, 1)
    duties(stm32, 1, 2000, 2000, 2000)
    start(stm32, 1)
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.step(PERIOD)
    assert stm32.gates == []
    drivers_on(stm32)
    stm32.step(PERIOD)
    assert {levels for _, _, _, levels in stm32.gates} >= {HIGH, LOW}
    stm32.write("GPIOB_BSRR", 1 << 28)
    assert {levels for _, _, _, levels in stm32.gates[-3:]} == {0}


def test_a_pin_without_its_function_is_low(stm32: Stm32Rig) -> None:
    drivers_on(stm32)
    set_up(stm32, 1)
    stm32.mode("A8", 0)
    duties(stm32, 1, 2000, 2000, 2000)
    start(stm32, 1)
    stm32.set_bits("TIM1_BDTR", MOE)
    stm32.step(2 * PERIOD)
    assert {levels for _, _, phase, levels in stm32.gates if phase == 0} == {0, LOW}


# ---- counters, triggers ---------------------------------------------------------------------------------------------


def test_count_and_direction(stm32: Stm32Rig) -> None:
    set_up(stm32, 1)
    begin = start(stm32, 1)
    for clock, count, down in ((1234, 1234, 0), (ARR, ARR, 1), (ARR + 250, ARR - 250, 1), (PERIOD + 7, 7, 0)):
        stm32.run(begin + clock)
        assert stm32.read("TIM1_CNT") == count
        assert stm32.read("TIM1_CR1") >> 4 & 1 == down


def test_timers_of_apb1_count_at_84_mhz(stm32: Stm32Rig) -> None:
    stm32.write_all({"TIM5_PSC": 83, "TIM5_ARR": 0xFFFF_FFFF, "TIM5_EGR": 1, "TIM5_CR1": 1})
    stm32.step(MS)
    assert stm32.read("TIM5_CNT") == 1000


def test_tim1_starts_tim8(stm32: Stm32Rig) -> None:
    """Trigger mode with ITR0: both count from 0 at one clock."""
    set_up(stm32, 1)
    set_up(stm32, 8, PWM2)
    stm32.write_all({"TIM1_EGR": 1, "TIM8_EGR": 1, "TIM1_CR2": 0x10, "TIM8_SMCR": 0x06})
    stm32.step(1000)
    assert stm32.read("TIM8_CR1") & 1 == 0
    stm32.set_bits("TIM1_CR1", 1)
    stm32.step(2000)
    assert stm32.read("TIM8_CNT") == stm32.read("TIM1_CNT") == 2000


def test_channel_4_triggers_behind_the_centre(stm32: Stm32Rig) -> None:
    """TIM1 in mode 1 behind the top, TIM8 in mode 2 behind the bottom: half a period apart."""
    for n, mode, compare in ((1, PWM1, ARR - 20), (8, PWM2, 20)):
        set_up(stm32, n, mode)
        tim = f"TIM{n}_"
        stm32.write_all({f"{tim}CCMR2": mode << 8 | mode, f"{tim}CCR4": compare, f"{tim}CR2": 0x70})
        stm32.set_bits(f"{tim}CCER", 0x1000)
    begins = [start(stm32, n) for n in (1, 8)]
    stm32.clear()
    stm32.step(2 * PERIOD)
    for timer, begin, centre in ((0, begins[0], ARR), (1, begins[1], 0)):
        for source in (0, 4):  # TRGO and CC4
            clocks = [e.clock - begin for e in stm32.events("trigger") if (e.a, e.b) == (timer, source)]
            assert clocks == [centre + 20, PERIOD + centre + 20]


def test_update_interrupts(stm32: Stm32Rig) -> None:
    stm32.write_all({"TIM2_ARR": 99, "TIM2_DIER": 1, "TIM2_EGR": 1, "TIM2_SR": 0, "TIM2_CR1": 1})
    stm32.step(199)
    assert not stm32.requested(28)
    stm32.step(1)
    assert stm32.requested(28)
    stm32.write("TIM2_SR", 0)
    assert not stm32.requested(28)


def test_complementary_compares_of_the_brake(stm32: Stm32Rig) -> None:
    """TIM2 channel 4 in mode 2, centre-aligned: high around ARR."""
    stm32.function("B11", 1)
    stm32.write_all(
        {
            "TIM2_CR1": 0x60,
            "TIM2_ARR": 4096,
            "TIM2_CCMR2": 0x7800,
            "TIM2_CCR4": 1000,
            "TIM2_CCER": 0x1000,
            "TIM2_EGR": 1,
        }
    )
    stm32.set_bits("TIM2_CR1", 1)
    begin = stm32.now
    for clock, level in ((900, False), (1100, True), (7100, True), (7300, False)):
        stm32.run(begin + 2 * clock)
        assert stm32.level("B11") is level


# ---- encoders -------------------------------------------------------------------------------------------------------

FORWARD = ((True, False), (True, True), (False, True), (False, False))


def encoder(rig: Stm32Rig, n: int, arr: int = 0xFFFF) -> tuple[str, str]:
    lines = {3: ("B4", "B5"), 4: ("B6", "B7")}[n]
    for line in lines:
        rig.pin(line, False)
        rig.function(line, 2)
    rig.write_all(
        {
            f"TIM{n}_ARR": arr,
            f"TIM{n}_CCMR1": 0x4141,
            f"TIM{n}_SMCR": 3,
            f"TIM{n}_EGR": 1,
            f"TIM{n}_SR": 0,
            f"TIM{n}_CR1": 1,
        }
    )
    return lines


def turn(rig: Stm32Rig, lines: tuple[str, str], counts: int) -> None:
    states = [(False, False), *FORWARD[:3]]
    for k in range(abs(counts)):
        a, b = states[(k + 1) % 4 if counts > 0 else -(k + 1) % 4]
        rig.pin(lines[0], a)
        rig.pin(lines[1], b)


@pytest.mark.parametrize("n", [3, 4])
def test_encoder_counts_all_edges_both_ways(stm32: Stm32Rig, n: int) -> None:
    lines = encoder(stm32, n)
    turn(stm32, lines, 12)
    assert stm32.read(f"TIM{n}_CNT") == 12
    assert not stm32.read(f"TIM{n}_CR1") & 0x10
    turn(stm32, lines, -20)
    assert stm32.read(f"TIM{n}_CNT") == 0x1_0000 - 8
    assert stm32.read(f"TIM{n}_CR1") & 0x10


def test_encoder_wraps_at_its_period(stm32: Stm32Rig) -> None:
    """Unsigned: 0..3999 and from 0 down to 3999."""
    lines = encoder(stm32, 3, 3999)
    turn(stm32, lines, -4)
    assert stm32.read("TIM3_CNT") == 3996
    assert stm32.read("TIM3_SR") & 1
    turn(stm32, lines, 8)
    assert stm32.read("TIM3_CNT") == 4


def test_swapped_polarity_counts_backwards(stm32: Stm32Rig) -> None:
    lines = encoder(stm32, 3)
    stm32.write("TIM3_CCER", 0x02)
    turn(stm32, lines, 8)
    assert stm32.read("TIM3_CNT") == 0x1_0000 - 8


def test_capture_of_the_count_and_of_its_time(stm32: Stm32Rig) -> None:
    """TIM3 captures its count at an edge of A; the same edge resets TIM5 by TRGO, which captures the time before."""
    lines = encoder(stm32, 3)
    stm32.write_all({"TIM3_CCER": 0x01, "TIM3_CR2": 0x30})  # MMS: compare pulse
    stm32.write_all(
        {"TIM5_ARR": 0xFFFF_FFFF, "TIM5_CCMR1": 0x03, "TIM5_CCER": 1, "TIM5_SMCR": 0x14, "TIM5_CR1": 1}
    )  # ITR1
    stm32.step(2000)
    turn(stm32, lines, 4)  # one rising edge of A
    assert stm32.read("TIM3_SR") & 2
    assert stm32.read("TIM3_CCR1") == 1
    assert not stm32.read("TIM3_SR") & 2  # reading has cleared it
    assert stm32.read("TIM5_CCR1") == 1000
    stm32.step(500)
    assert stm32.read("TIM5_CNT") == 250
    turn(stm32, lines, 8)
    assert stm32.read("TIM3_SR") & 0x202 == 0x202  # over-capture


# ---- what is not modelled -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("register", "value"),
    [
        ("TIM1_CR1", 0x10),
        ("TIM1_CR2", 0x100),
        ("TIM3_SMCR", 5),
        ("TIM3_SMCR", 7),
        ("TIM2_DIER", 0x100),
        ("TIM1_CCMR1", 0x80),
    ],
)
def test_other_modes_stop_the_chip(stm32: Stm32Rig, register: str, value: int) -> None:
    with pytest.raises(Stm32Error, match=register[:4]):
        stm32.write(register, value)


def test_registers_need_their_clock(stm32: Stm32Rig) -> None:
    stm32.write("RCC_APB2ENR", 0)
    with pytest.raises(Stm32Error, match="TIM8 is accessed while its clock is off"):
        stm32.write("TIM8_CR1", 0)
