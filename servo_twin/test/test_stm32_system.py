"""The rest of the STM32F405: clocks, pins, external interrupts, serial line with DMA, gate drivers, flash, watchdog."""

from __future__ import annotations

import pytest
from native_library import Native
from stm32_rig import ADDRESS, APB1, MS, RAM, Stm32Error, Stm32Rig

# ---- clocks ---------------------------------------------------------------------------------------------------------


def test_clocks_have_an_order(stm32_c: Native) -> None:
    rig = Stm32Rig(stm32_c, start=False)
    assert rig.read("RCC_CR") & 0x0202_0003 == 3  # the internal oscillator alone
    rig.write("RCC_CR", 0x0001_0081)
    assert not rig.read("RCC_CR") & 1 << 17
    with pytest.raises(Stm32Error, match="before the crystal is ready"):
        rig.write("RCC_CR", 0x0101_0081)


@pytest.mark.parametrize(
    ("register", "value", "message"),
    [
        ("FLASH_ACR", 0x704, "5 wait states"),
        ("RCC_PLLCFGR", 0x0740_2A08, "only 168 MHz"),
        ("PWR_CR", 0, "voltage scale"),
        ("RCC_CFGR", 0x1000, "only 168 MHz"),
    ],
)
def test_another_clock_is_refused(stm32_c: Native, register: str, value: int, message: str) -> None:
    rig = Stm32Rig(stm32_c, start=False)
    rig.write("RCC_APB1ENR", 1 << 28)
    settings = {"PWR_CR": 1 << 14, "RCC_PLLCFGR": 0x0740_2A04, "FLASH_ACR": 0x705, "RCC_CFGR": 0x9400} | {
        register: value
    }
    rig.write_all(settings)
    rig.write("RCC_CR", 0x0001_0081)
    rig.step(3 * MS)
    rig.write("RCC_CR", 0x0101_0081)
    rig.step(MS)
    with pytest.raises(Stm32Error, match=message):
        rig.write("RCC_CFGR", settings["RCC_CFGR"] | 2)


def test_system_clock_status(stm32: Stm32Rig) -> None:
    assert stm32.read("RCC_CFGR") == 0x940A


def test_nothing_starts_at_another_clock(stm32_c: Native) -> None:
    rig = Stm32Rig(stm32_c, start=False)
    rig.write_all({"RCC_APB2ENR": 1, "TIM1_ARR": 99})
    with pytest.raises(Stm32Error, match="TIM1 starts at another clock"):
        rig.write("TIM1_CR1", 1)


def test_unknown_registers_stop_the_chip(stm32: Stm32Rig) -> None:
    with pytest.raises(Stm32Error, match="RCC register 50h"):
        stm32.read_at(0x4002_3850)


# ---- pins -----------------------------------------------------------------------------------------------------------


def test_reset_values_of_ports(stm32_c: Native) -> None:
    rig = Stm32Rig(stm32_c, start=False)
    rig.write("RCC_AHB1ENR", 0xF)
    assert [rig.read(f"GPIO{port}_MODER") for port in "ABCD"] == [0xA800_0000, 0x280, 0, 0]
    assert [rig.read(f"GPIO{port}_PUPDR") for port in "ABCD"] == [0x6400_0000, 0x100, 0, 0]


def test_levels(stm32: Stm32Rig) -> None:
    """Output, open drain, pull-up, level from outside, analogue."""
    stm32.mode("C4", 1)
    stm32.write("GPIOC_BSRR", 1 << 4)
    assert stm32.level("C4")
    stm32.write("GPIOC_BSRR", 1 << 20)
    assert not stm32.level("C4")
    stm32.write("GPIOC_OTYPER", 1 << 4)
    stm32.write("GPIOC_ODR", 1 << 4)
    assert not stm32.level("C4")
    stm32.write("GPIOC_PUPDR", 1 << 8)
    assert stm32.level("C4")
    stm32.pin("C9", True)
    assert stm32.read("GPIOC_IDR") >> 9 & 1
    stm32.mode("C9", 3)
    assert not stm32.read("GPIOC_IDR") >> 9 & 1


@pytest.mark.parametrize(("pin", "irq", "select"), [("D2", 8, 0x300), ("C9", 23, 0x20), ("C15", 40, 0x2000)])
def test_external_interrupts(stm32: Stm32Rig, pin: str, irq: int, select: int) -> None:
    line = int(pin[1:])
    other = "A" + pin[1:]
    stm32.mode(other, 0)
    for name in (pin, other):
        stm32.pin(name, True)
    stm32.write_all({f"SYSCFG_EXTICR{line // 4 + 1}": select, "EXTI_FTSR": 1 << line, "EXTI_IMR": 1 << line})
    stm32.pin(other, False)  # the pin of the same number of another port
    assert not stm32.requested(irq)
    stm32.pin(pin, False)
    assert stm32.requested(irq)
    stm32.pin(pin, True)
    stm32.write("EXTI_PR", 1 << line)
    assert not stm32.requested(irq)
    stm32.pin(pin, True)
    assert not stm32.requested(irq)
    stm32.write("EXTI_SWIER", 1 << line)
    assert stm32.requested(irq)


# ---- serial line ----------------------------------------------------------------------------------------------------

BIT = 0x16D * APB1


def serial(rig: Stm32Rig, dma: bool = False) -> None:
    """115200 baud; by DMA a ring of 16 bytes at RAM, sent from RAM + 100h."""
    rig.function("A2", 7)
    rig.function("A3", 7)
    rig.write_all({"USART2_BRR": 0x16D, "USART2_CR3": 0xC0 if dma else 0, "USART2_CR1": 0x200C})
    if dma:
        rig.write_all({"DMA1_S5PAR": ADDRESS["USART2_DR"], "DMA1_S5M0AR": RAM, "DMA1_S5NDTR": 16})
        rig.write("DMA1_S5CR", 4 << 25 | 1 << 10 | 1 << 8 | 1)


def test_a_byte_each_way(stm32: Stm32Rig) -> None:
    serial(stm32)
    stm32.send(b"\xa5")
    stm32.step(10 * BIT + 50)
    assert stm32.read("USART2_SR") & 0x20
    assert stm32.read("USART2_DR") == 0xA5
    assert not stm32.read("USART2_SR") & 0x20
    stm32.write("USART2_DR", 0x5A)
    assert stm32.read("USART2_SR") & 0xC0 == 0x80  # TXE, not TC
    stm32.step(10 * BIT)
    assert stm32.read("USART2_SR") & 0xC0 == 0xC0
    assert stm32.received() == b"\x5a"


def test_an_unread_byte_overruns(stm32: Stm32Rig) -> None:
    serial(stm32)
    stm32.send(b"abc")
    stm32.step(31 * BIT)
    assert stm32.read("USART2_SR") & 0x28 == 0x28
    assert stm32.read("USART2_DR") == ord("a")
    assert not stm32.read("USART2_SR") & 0x28


def test_another_baud_rate_gives_wrong_bytes(stm32: Stm32Rig) -> None:
    serial(stm32)
    stm32.write("USART2_BRR", 0x2DA)
    stm32.send(b"U")
    stm32.step(11 * BIT)
    assert stm32.read("USART2_DR") != ord("U")


def test_a_line_without_its_pins_is_silent(stm32: Stm32Rig) -> None:
    serial(stm32)
    stm32.mode("A2", 0)
    stm32.mode("A3", 0)
    stm32.send(b"a")
    stm32.write("USART2_DR", 1)
    stm32.step(11 * BIT)
    assert not stm32.read("USART2_SR") & 0x20
    assert stm32.received() == b""


def test_reception_by_dma_runs_in_a_circle(stm32: Stm32Rig) -> None:
    serial(stm32, dma=True)
    data = bytes(range(1, 21))
    stm32.send(data)
    stm32.step(201 * BIT)
    assert stm32.ram(0, 16) == data[16:] + data[4:16]
    assert stm32.read("DMA1_S5NDTR") == 12
    assert stm32.read("DMA1_HISR") & 0xC00 == 0xC00  # half and all of stream 5


def test_transmission_by_dma(stm32: Stm32Rig) -> None:
    """Back to back; TCIF when the last byte is in the transmitter, TC when it is on the line."""
    serial(stm32, dma=True)
    data = bytes(range(10))
    for k, byte in enumerate(data):
        stm32.ffi.buffer(stm32.lib.rig_ram(stm32.rig) + 0x100, 16)[k] = bytes([byte])
    stm32.write_all({"DMA1_S6PAR": ADDRESS["USART2_DR"], "DMA1_S6M0AR": RAM + 0x100, "DMA1_S6NDTR": len(data)})
    stm32.write("DMA1_S6CR", 4 << 25 | 1 << 10 | 1 << 6 | 1)
    stm32.step(100 * BIT + 10)
    assert stm32.received() == data
    assert stm32.read("DMA1_S6CR") & 1 == 0
    assert stm32.read("DMA1_HISR") >> 21 & 1
    with pytest.raises(Stm32Error, match="before its flags are cleared"):
        stm32.write_all({"DMA1_S6NDTR": 1, "DMA1_S6CR": 4 << 25 | 1 << 6 | 1})


def test_dma_does_not_reach_the_ccm(stm32: Stm32Rig) -> None:
    serial(stm32, dma=False)
    stm32.write_all({"DMA1_S5PAR": ADDRESS["USART2_DR"], "DMA1_S5M0AR": 0x1000_0000, "DMA1_S5NDTR": 16})
    stm32.write_all({"DMA1_S5CR": 4 << 25 | 1 << 10 | 1, "USART2_CR3": 0x40})
    stm32.send(b"a")
    with pytest.raises(Stm32Error, match="DMA1 stream 5"):
        stm32.step(11 * BIT)


# ---- gate drivers ---------------------------------------------------------------------------------------------------

SELECT = ("C13", "C14")


def drivers(rig: Stm32Rig) -> None:
    """SPI3 at 2.6 MHz, chip selects high, EN_GATE high for 20 ms."""
    rig.write("GPIOC_BSRR", 3 << 13)
    for name in SELECT:
        rig.mode(name, 1)
    for name in ("C10", "C11", "C12"):
        rig.function(name, 6)
    rig.write("SPI3_CR1", 0x0B5D)  # 16 bits, SSM, SSI, SPE, /16, master, CPHA
    rig.mode("B12", 1)
    rig.write("GPIOB_BSRR", 1 << 12)
    rig.step(20 * MS)


def frame(rig: Stm32Rig, driver: int, word: int) -> int:
    rig.write("GPIOC_BSRR", 1 << (29 + driver))
    rig.write("SPI3_DR", word)
    rig.step(16 * 16 * APB1 - 1)
    assert rig.read("SPI3_SR") & 0x81 == 0x80
    rig.step(1)
    assert rig.read("SPI3_SR") & 0x83 == 3
    rig.write("GPIOC_BSRR", 1 << (13 + driver))
    rig.step(168)
    return rig.read("SPI3_DR")


def read(rig: Stm32Rig, driver: int, register: int) -> int:
    """The answer comes in the next frame."""
    frame(rig, driver, 0x8000 | register << 11)
    return frame(rig, driver, 0x8000 | register << 11)


def test_registers_of_the_gate_drivers(stm32: Stm32Rig) -> None:
    drivers(stm32)
    frame(stm32, 0, 2 << 11 | 21 << 6 | 1 << 4)
    frame(stm32, 0, 3 << 11 | 3 << 2)
    assert read(stm32, 0, 2) == 2 << 11 | 21 << 6 | 1 << 4
    assert read(stm32, 0, 3) == 3 << 11 | 3 << 2
    assert read(stm32, 1, 3) == 3 << 11
    assert [stm32.lib.rig_gain(stm32.rig, d) for d in (0, 1)] == [80, 10]
    assert read(stm32, 0, 0) == 0


def test_the_drivers_need_time(stm32: Stm32Rig) -> None:
    drivers(stm32)
    stm32.write("GPIOB_BSRR", 1 << 28)
    stm32.step(100)
    assert not stm32.level("D2")
    stm32.write("GPIOB_BSRR", 1 << 12)
    stm32.step(9 * MS)
    frame(stm32, 0, 3 << 11 | 3 << 2)
    assert not stm32.level("D2")
    stm32.step(2 * MS)
    assert stm32.level("D2")
    assert read(stm32, 0, 3) == 3 << 11  # written too early, and lost by the reset


@pytest.mark.parametrize("cr1", [0x0B5C, 0x0B5F, 0x0B45])
def test_another_mode_of_the_spi_reaches_nothing(stm32: Stm32Rig, cr1: int) -> None:
    """CPHA 0; CPOL 1; 21 MHz."""
    drivers(stm32)
    stm32.write("SPI3_CR1", cr1)
    stm32.write("GPIOC_BSRR", 1 << 29)
    stm32.write("SPI3_DR", 3 << 11 | 3 << 2)
    stm32.step(2000)
    assert stm32.read("SPI3_DR") == 0xFFFF
    stm32.write("GPIOC_BSRR", 1 << 13)
    assert stm32.lib.rig_gain(stm32.rig, 0) == 10


def test_two_frames_without_a_pulse_of_the_select_are_an_error(stm32: Stm32Rig) -> None:
    drivers(stm32)
    stm32.write("GPIOC_BSRR", 1 << 29)
    for _ in range(2):
        stm32.write("SPI3_DR", 3 << 11 | 3 << 2)
        stm32.step(2000)
        stm32.read("SPI3_DR")
    stm32.write("GPIOC_BSRR", 1 << 13)
    assert stm32.lib.rig_gain(stm32.rig, 0) == 10


def test_an_over_current_is_latched_until_a_gate_reset(stm32: Stm32Rig) -> None:
    drivers(stm32)
    control = 2 << 11 | 1 << 4
    frame(stm32, 1, control)
    stm32.lib.rig_over_current(stm32.rig, 1, True)
    assert not stm32.level("D2")
    stm32.lib.rig_over_current(stm32.rig, 1, False)
    assert not stm32.level("D2")
    assert read(stm32, 1, 0) & 0x400
    assert not read(stm32, 0, 0) & 0x400
    frame(stm32, 1, control | 4)
    assert stm32.level("D2")
    assert read(stm32, 1, 0) == 0


# ---- flash ----------------------------------------------------------------------------------------------------------

SECTOR_1, KEYS = 0x0800_4000, (0x4567_0123, 0xCDEF_89AB)


def unlock(rig: Stm32Rig) -> None:
    for key in KEYS:
        rig.write("FLASH_KEYR", key)


def stored(rig: Stm32Rig, address: int) -> int:
    at = rig.lib.rig_flash(rig.rig) + (address - 0x0800_0000)
    return int.from_bytes(bytes(rig.ffi.buffer(at, 4)), "little")


def test_a_word_is_programmed_and_erased(stm32: Stm32Rig) -> None:
    unlock(stm32)
    stm32.write("FLASH_CR", 0x201)
    stm32.write_at(SECTOR_1 + 8, 0x1234_5678)
    assert stm32.lib.rig_stall(stm32.rig) == pytest.approx(16 * 168, abs=2)
    assert stm32.read("FLASH_SR") == 1 << 16
    stm32.step(16 * 168 + 2)
    assert stm32.read("FLASH_SR") == 0
    assert stored(stm32, SECTOR_1 + 8) == 0x1234_5678
    stm32.write("FLASH_CR", 1 << 16 | 1 << 3 | 2)
    assert stm32.lib.rig_stall(stm32.rig) == pytest.approx(250 * MS, abs=2)
    stm32.step(250 * MS - 10)
    assert stm32.read("FLASH_SR") == 1 << 16
    stm32.step(12)
    assert stm32.read("FLASH_SR") == 0
    assert stored(stm32, SECTOR_1 + 8) == 0xFFFF_FFFF


def test_programming_only_clears_bits(stm32: Stm32Rig) -> None:
    unlock(stm32)
    stm32.write("FLASH_CR", 0x201)
    for value in (0xFFFF_00FF, 0x00FF_FFFF):
        stm32.write_at(SECTOR_1, value)
        stm32.step(3000)
    assert stored(stm32, SECTOR_1) == 0x00FF_00FF


def test_programming_needs_its_bit_and_its_size(stm32: Stm32Rig) -> None:
    unlock(stm32)
    for cr in (0x200, 0x001):
        stm32.write("FLASH_CR", cr)
        stm32.write_at(SECTOR_1, 0)
        assert stm32.read("FLASH_SR") & 0x80  # PGSERR
        stm32.write("FLASH_SR", 0xF2)
    assert stored(stm32, SECTOR_1) == 0xFFFF_FFFF


@pytest.mark.parametrize("sector", [0, 3, 4, 11])
def test_the_program_is_not_erased(stm32: Stm32Rig, sector: int) -> None:
    unlock(stm32)
    with pytest.raises(Stm32Error, match=f"sector {sector} of the flash"):
        stm32.write("FLASH_CR", 1 << 16 | sector << 3 | 2)


def test_the_flash_is_locked(stm32: Stm32Rig) -> None:
    unlock(stm32)
    for _ in range(2):  # to lock it again changes nothing
        stm32.write("FLASH_CR", 1 << 31)
    with pytest.raises(Stm32Error, match="locked"):
        stm32.write("FLASH_CR", 1)


def test_a_wrong_key(stm32: Stm32Rig) -> None:
    with pytest.raises(Stm32Error, match="key"):
        stm32.write("FLASH_KEYR", KEYS[1])


# ---- watchdog, reset ------------------------------------------------------------------------------------------------


def test_watchdog(stm32: Stm32Rig) -> None:
    """PR 0, RLR 400: 50 ms nominal."""
    stm32.write("RCC_CSR", 1 << 24)
    stm32.write_all({"IWDG_KR": 0xCCCC})
    stm32.write_all({"IWDG_KR": 0x5555, "IWDG_PR": 0, "IWDG_RLR": 400})
    stm32.write("IWDG_KR", 0xAAAA)
    assert not stm32.step(50 * MS)
    stm32.write("IWDG_KR", 0xAAAA)
    assert not stm32.step(50 * MS)
    assert stm32.step(MS)
    assert stm32.read("RCC_CSR") >> 24 & 0xFF == 0x24  # IWDG and PIN
    assert stm32.read("RCC_CR") & 1 << 25 == 0
    stm32.write("RCC_CSR", 1 << 24)
    assert stm32.read("RCC_CSR") >> 24 == 0


def test_watchdog_is_locked(stm32: Stm32Rig) -> None:
    with pytest.raises(Stm32Error, match="locked"):
        stm32.write("IWDG_RLR", 1)
