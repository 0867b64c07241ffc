"""Converters of the STM32F405: sequences, triggers, sample times, results by DMA, the analog watchdog."""

from __future__ import annotations

import pytest
from stm32_rig import ADDRESS, ARR, PERIOD, RAM, Stm32Error, Stm32Rig

CLOCK = 8
"""Clocks of 168 MHz per clock of a converter at 84 / 4 MHz."""
LATENCY, SAMPLE, CONVERSION = 2 * CLOCK, 15 * CLOCK, 12 * CLOCK
EOC, JEOC, AWD, OVR = 2, 4, 1, 0x20
ADC = 18


@pytest.fixture
def adc(stm32: Stm32Rig) -> Stm32Rig:
    """All on, with 15 clocks of sample time for the inputs 10 to 15."""
    stm32.write("ADC_CCR", 1 << 16)
    for n in (1, 2, 3):
        stm32.write_all({f"ADC{n}_SMPR1": 0o111111, f"ADC{n}_CR2": 1})
    return stm32


def injected(*channels: int) -> int:
    """JSQR of a sequence."""
    return (len(channels) - 1) << 20 | sum(c << 5 * (4 - len(channels) + k) for k, c in enumerate(channels))


def test_an_injected_sequence(adc: Stm32Rig) -> None:
    """Two conversions are JSQ3 and JSQ4, with results in JDR1, JDR2; a channel is held after its sample time."""
    adc.write_all({"ADC2_CR1": 0x180, "ADC2_JSQR": injected(10, 13)})
    begin = adc.now
    adc.set_bits("ADC2_CR2", 1 << 22)
    end = LATENCY + 2 * (SAMPLE + CONVERSION)
    adc.run(begin + end - 1)
    assert not adc.requested(ADC)
    adc.run(begin + end)
    assert adc.requested(ADC)
    assert adc.read("ADC2_SR") & JEOC
    assert [adc.read(f"ADC2_JDR{k}") for k in (1, 2)] == [1000, 1300]
    held = [(e.clock - begin, e.b) for e in adc.events("sample")]
    assert held == [(LATENCY + SAMPLE, 10), (LATENCY + SAMPLE + CONVERSION + SAMPLE, 13)]
    adc.write("ADC2_SR", ~JEOC & 0x3F)
    assert not adc.requested(ADC)


def test_one_conversion_is_jsq4(adc: Stm32Rig) -> None:
    adc.write_all({"ADC1_JSQR": 6 << 15 | 3 << 10 | 2 << 5 | 1})
    adc.set_bits("ADC1_CR2", 1 << 22)
    adc.step(1000)
    assert adc.read("ADC1_JDR1") == 600


def test_offsets_are_subtracted(adc: Stm32Rig) -> None:
    adc.write_all({"ADC1_JSQR": injected(6), "ADC1_JOFR1": 700})
    adc.set_bits("ADC1_CR2", 1 << 22)
    adc.step(1000)
    assert adc.read("ADC1_JDR1") == 0x1_0000 - 100


@pytest.mark.parametrize(("code", "clocks"), [*enumerate((3, 15, 28, 56, 84, 112, 144, 480))])
def test_sample_times(adc: Stm32Rig, code: int, clocks: int) -> None:
    adc.write_all({"ADC1_SMPR2": code << 18, "ADC1_JSQR": injected(6)})
    begin = adc.now
    adc.set_bits("ADC1_CR2", 1 << 22)
    adc.step(600 * CLOCK)
    assert [e.clock - begin for e in adc.events("sample")] == [LATENCY + clocks * CLOCK]


def timers(rig: Stm32Rig) -> None:
    """TIM1, which starts TIM8, with triggers by channel 4 just behind the low-side centres; not started."""
    for n, mode, compare in ((1, 0x68, ARR - 1), (8, 0x78, 1)):
        tim = f"TIM{n}_"
        rig.write_all({f"{tim}CR1": 0xE0, f"{tim}ARR": ARR, f"{tim}CCMR2": mode << 8, f"{tim}CCR4": compare})
        rig.write_all({f"{tim}CCER": 0x1000, f"{tim}EGR": 1})
    rig.write_all({"TIM8_CR2": 0x70, "TIM1_CR2": 0x10, "TIM8_SMCR": 6})


def test_both_motors_are_sampled_half_a_period_apart(adc: Stm32Rig) -> None:
    """Currents of motor 1 by TIM1_CC4, injected; of motor 2 by TIM8_TRGO, regular, which fetches two results by DMA."""
    timers(adc)  # whose set-up is an edge of channel 4, too
    adc.write_all({"ADC2_CR1": 0x180, "ADC2_JSQR": injected(10, 13), "ADC2_CR2": 1 | 1 << 20})
    adc.write_all({"ADC2_SQR1": 1 << 20, "ADC2_SQR3": 13 | 10 << 5})
    adc.write("ADC2_CR2", 1 | 1 << 20 | 14 << 24 | 1 << 28 | 1 << 8 | 1 << 9)
    adc.write_all({"DMA2_S2PAR": ADDRESS["ADC2_DR"], "DMA2_S2M0AR": RAM + 0x100, "DMA2_S2NDTR": 2})
    adc.write("DMA2_S2CR", 1 << 25 | 1 << 13 | 1 << 11 | 1 << 10 | 1 << 8 | 1 << 4 | 1)
    begin = adc.now
    adc.set_bits("TIM1_CR1", 1)
    adc.run(begin + 3 * PERIOD - 2000)
    held = [(e.clock - begin - LATENCY - SAMPLE, e.b) for e in adc.events("sample")]
    second = SAMPLE + CONVERSION
    period = [(1, 13), (1 + second, 10), (ARR + 1, 10), (ARR + 1 + second, 13)]
    assert held == [(clock + k * PERIOD, channel) for k in range(3) for clock, channel in period][: len(held)]
    assert len(held) == 12
    assert adc.requested(58)
    assert adc.ram(0x100, 4) == (1300).to_bytes(2, "little") + (1000).to_bytes(2, "little")
    adc.write("DMA2_LIFCR", 0x3D << 16)
    assert not adc.requested(58)


def test_an_injected_trigger_interrupts_a_regular_sequence(adc: Stm32Rig) -> None:
    """The interrupted conversion begins anew."""
    adc.write_all({"ADC1_CR1": 0x100, "ADC1_SQR1": 0, "ADC1_SQR3": 15, "ADC1_JSQR": injected(10)})
    adc.set_bits("ADC1_CR2", 1 << 30)
    adc.step(LATENCY + SAMPLE + 10)  # the channel is held already
    begin = adc.now
    adc.set_bits("ADC1_CR2", 1 << 22)
    adc.step(2000)
    held = [(e.clock - begin, e.b) for e in adc.events("sample")][1:]
    first = LATENCY + SAMPLE
    assert held == [(first, 10), (first + CONVERSION + SAMPLE, 15)]
    assert adc.read("ADC1_SR") & (EOC | JEOC) == EOC | JEOC
    assert adc.read("ADC1_DR") == 1500
    assert not adc.read("ADC1_SR") & EOC  # reading DR has cleared it


def test_a_trigger_during_its_sequence_is_lost(adc: Stm32Rig) -> None:
    adc.write_all({"ADC1_CR1": 0x100, "ADC1_JSQR": injected(10, 11)})
    adc.set_bits("ADC1_CR2", 1 << 22)
    adc.step(100)
    adc.set_bits("ADC1_CR2", 1 << 22)
    adc.step(5000)
    assert len(adc.events("sample")) == 2


def test_overrun(adc: Stm32Rig) -> None:
    """With EOCS a result that is not read is not overwritten."""
    adc.write_all({"ADC1_CR1": 0x100, "ADC1_SQR1": 1 << 20, "ADC1_SQR3": 10 | 11 << 5})
    adc.write("ADC1_CR2", 1 | 1 << 10 | 1 << 30)
    adc.step(2000)
    assert adc.read("ADC1_SR") & OVR
    assert adc.read("ADC1_DR") == 1000
    assert adc.read("ADC_CSR") & OVR


@pytest.mark.parametrize(("code", "alarm"), [(372, False), (371, True), (3723, False), (3724, True)])
def test_analog_watchdog(adc: Stm32Rig, code: int, alarm: bool) -> None:
    adc.codes[10] = code
    adc.write_all({"ADC3_CR1": 1 << 22 | 1 << 6, "ADC3_HTR": 3723, "ADC3_LTR": 372, "ADC3_JSQR": injected(10)})
    adc.set_bits("ADC3_CR2", 1 << 22)
    adc.step(1000)
    assert bool(adc.read("ADC3_SR") & AWD) is alarm
    assert adc.requested(ADC) is alarm


def test_a_converter_that_is_off_does_nothing(adc: Stm32Rig) -> None:
    adc.write_all({"ADC1_JSQR": injected(10), "ADC1_CR2": 0})
    adc.write("ADC1_CR2", 1 << 22)
    adc.step(1000)
    assert adc.events("sample") == []


def test_the_clock_has_a_limit(stm32: Stm32Rig) -> None:
    with pytest.raises(Stm32Error, match="36 MHz"):
        stm32.write("ADC_CCR", 0)


def test_inputs_of_adc3(adc: Stm32Rig) -> None:
    """Input 6 is PA6 on ADC1 and ADC2 only."""
    adc.write("ADC3_JSQR", injected(6))
    with pytest.raises(Stm32Error, match="ADC3 converts channel 6"):
        adc.set_bits("ADC3_CR2", 1 << 22)
