"""Every definition of the STM32F405's registers.h agrees with descriptions of the chip that others wrote."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

import pytest
from chip_description import ChipDescription, Register
from firmware_compiler import FIRMWARE, CompileProgram

HEADER: Final = FIRMWARE / "port/stm32f405/registers.h"
ALL_ONES: Final = "0xFFFFFFFFU"

PERIPHERALS: Final = {
    "ADC_COMMON": ("C_ADC",),
    "ADC": ("ADC1", "ADC2", "ADC3"),
    "DBGMCU": ("DBG",),
    "DMA": ("DMA1", "DMA2"),
    "EXTI": ("EXTI",),
    "FLASH": ("FLASH",),
    "GPIO": ("GPIOA", "GPIOB", "GPIOC", "GPIOD"),
    "IWDG": ("IWDG",),
    "NVIC": ("NVIC",),
    "PWR": ("PWR",),
    "RCC": ("RCC",),
    "SPI": ("SPI3",),
    "SYSCFG": ("SYSCFG",),
    "TIM": ("TIM1", "TIM8", "TIM2", "TIM3", "TIM4", "TIM5"),
    "USART": ("USART2",),
}
"""Peripherals of the description that have the registers with a prefix."""

ADVANCED: Final = ("TIM1", "TIM8")
"""The only timers with complementary outputs."""

INDEXED: Final[Mapping[str, tuple[Callable[[int], str], range]]] = {
    "GPIO_MODER_MODER": (lambda n: f"MODER{n}", range(16)),
    "GPIO_OSPEEDR_OSPEEDR": (lambda n: f"OSPEEDR{n}", range(16)),
    "GPIO_PUPDR_PUPDR": (lambda n: f"PUPDR{n}", range(16)),
    "GPIO_IDR_IDR": (lambda n: f"IDR{n}", range(16)),
    "GPIO_ODR_ODR": (lambda n: f"ODR{n}", range(16)),
    "GPIO_BSRR_BS": (lambda n: f"BS{n}", range(16)),
    "GPIO_BSRR_BR": (lambda n: f"BR{n}", range(16)),
    "GPIO_AFRL_AFRL": (lambda n: f"AFRL{n}", range(8)),
    "GPIO_AFRH_AFRH": (lambda n: f"AFRH{n}", range(8, 16)),
    "SYSCFG_EXTICR": (lambda n: f"EXTICR{n // 4 + 1}", range(16)),
    "SYSCFG_EXTICR_EXTI": (lambda n: f"EXTI{n}", range(16)),
    "EXTI_IMR_MR": (lambda n: f"MR{n}", range(16)),
    "EXTI_RTSR_TR": (lambda n: f"TR{n}", range(16)),
    "EXTI_FTSR_TR": (lambda n: f"TR{n}", range(16)),
    "EXTI_SWIER_SWIER": (lambda n: f"SWIER{n}", range(16)),
    "EXTI_PR_PR": (lambda n: f"PR{n}", range(16)),
    "DMA_ISR": (lambda n: f"{'LH'[n // 4]}ISR", range(8)),
    "DMA_IFCR": (lambda n: f"{'LH'[n // 4]}IFCR", range(8)),
    "DMA_ISR_FEIF": (lambda n: f"FEIF{n}", range(8)),
    "DMA_ISR_DMEIF": (lambda n: f"DMEIF{n}", range(8)),
    "DMA_ISR_TEIF": (lambda n: f"TEIF{n}", range(8)),
    "DMA_ISR_HTIF": (lambda n: f"HTIF{n}", range(8)),
    "DMA_ISR_TCIF": (lambda n: f"TCIF{n}", range(8)),
    "DMA_SCR": (lambda n: f"S{n}CR", range(8)),
    "DMA_SNDTR": (lambda n: f"S{n}NDTR", range(8)),
    "DMA_SPAR": (lambda n: f"S{n}PAR", range(8)),
    "DMA_SM0AR": (lambda n: f"S{n}M0AR", range(8)),
    "DMA_SFCR": (lambda n: f"S{n}FCR", range(8)),
    "NVIC_ISER": (lambda n: f"ISER{n // 32}", range(82)),
    "NVIC_ICER": (lambda n: f"ICER{n // 32}", range(82)),
    "NVIC_ISPR": (lambda n: f"ISPR{n // 32}", range(82)),
    "NVIC_ICPR": (lambda n: f"ICPR{n // 32}", range(82)),
    "NVIC_IPR": (lambda n: f"IPR{n // 4}", range(82)),
    "NVIC_IPR_IPR": (lambda n: f"IPR_N{n % 4}", range(82)),
}
"""Names in the description of what depends on a number."""

RENAMED: Final = {
    "RCC_AHB1ENR_CCMDATARAMEN": None,  # missing in the description
    "PWR_CR_VOS": None,  # the description has that of a chip without it
    "DMA_ISR_ALL": None,  # of the flags before it
    "DMA_FLAG": None,  # used by the flags behind it
    "NVIC_IRQ": None,  # bits of the registers of 32 interrupts
    "NVIC_PRIORITY_BITS": None,
    "IRQS": None,
    "DBGMCU_APB1_FZ_TIM5": "DBG_TIM5_STOP",
    "DBGMCU_APB1_FZ_IWDG": "DBG_IWDEG_STOP",
    "DBGMCU_APB2_FZ_TIM1": "DBG_TIM1_STOP",
    "DBGMCU_APB2_FZ_TIM8": "DBG_TIM8_STOP",
}
"""Field names that differ, and definitions that no description has."""

BY_BITS: Final = {
    "RCC_PLLCFGR_PLLM",
    "RCC_PLLCFGR_PLLN",
    "RCC_PLLCFGR_PLLP",
    "RCC_PLLCFGR_PLLQ",
    "RCC_CFGR_SW",
    "RCC_CFGR_SWS",
}
"""Fields that the description has bit by bit."""

SAMPLE_TIMES: Final = {"ADC_SMPR1_SMP", "ADC_SMPR2_SMP"}
"""Three bits to a channel; the description does not split the register."""


class Definitions:
    """The definitions of the header with their values."""

    def __init__(self, compile_program: CompileProgram, folder: Path) -> None:
        text = HEADER.read_text(encoding="ascii")
        found = re.findall(r"^#define (\w+)(?:\(([^)]*)\))?(?=[ \\])", text, re.MULTILINE)
        self.parameters = {name: [p.strip() for p in given.split(",") if p.strip()] for name, given in found}
        for name in ("BIT", "FIELD", "FIELD_MASK", "FIELD_GET"):
            del self.parameters[name]
        offset = r"^#define (\w+)(?:\(n\))? \(?0x\w+U(?: \+ [^\n]*)?\)?(?: /\*.*)?$"
        number = r"^#define (\w+) (?:\d+U|0x\w{4}U|UINT32_C\(\w+\))(?= |$)"
        mine = {name for name in self.parameters if self._is_of_registers(name)}
        self.registers = {n for n in re.findall(offset, text, re.MULTILINE) if n in mine and "KR_" not in n}
        self.registers |= {"DMA_ISR", "DMA_IFCR"}
        self.codes = {n for n in re.findall(number, text, re.MULTILINE) if n in mine} - self.registers
        self.fields = mine - self.registers - self.codes
        self._calls = sorted(set(self._all_calls()))
        lines = [f'printf("%s %lu\\n", "{call}", (unsigned long)({call}));' for call in self._calls]
        source = folder / "registers.c"
        include = '#include <stdio.h>\n#include "port/stm32f405/registers.h"\n'
        source.write_text(f"{include}int main(void)\n{{\n{chr(10).join(lines)}\nreturn 0;\n}}\n", encoding="ascii")
        program = compile_program("registers", [source])
        output = subprocess.run([program], capture_output=True, text=True, check=True).stdout
        self.values = {call: int(value) for call, value in (line.rsplit(" ", 1) for line in output.splitlines())}

    def _all_calls(self) -> Iterator[str]:
        for name, parameters in self.parameters.items():
            if not parameters:
                yield name
            elif parameters == ["v"]:
                yield f"{name}({ALL_ONES})"
            else:
                yield from (self.call(name, n) for n in self.numbers(name))

    def _is_of_registers(self, name: str) -> bool:
        others = ("FLASH_MEMORY", "FLASH_SECTOR")
        told = RENAMED.get(name, name) is None or name.endswith("_BASE")
        return prefix_of(name) is not None and not name.startswith(others) and not told

    def register_of(self, name: str) -> str:
        """Register of a field or of a code."""
        found: list[str] = [r for r in self.registers if name.startswith(f"{r}_")]
        assert found, f"{name} is neither a register nor a field nor a code"
        return max(found, key=len)

    def numbers(self, name: str) -> range:
        """Numbers for which a definition is evaluated."""
        return INDEXED[name][1] if name in INDEXED else self.special_numbers(name)

    def special_numbers(self, name: str) -> range:
        """Numbers of definitions with their own test."""
        if name.startswith("ADC_SMPR"):
            return range(10, 19) if name.startswith("ADC_SMPR1") else range(10)
        return range(12) if name.startswith("FLASH_SECTOR") else range(8)

    def call(self, name: str, n: int) -> str:
        """Expression with a number, and the mask of the field if it is one."""
        return f"{name}({n}U, {ALL_ONES})" if len(self.parameters[name]) == 2 else f"{name}({n}U)"

    def value(self, name: str, n: int | None = None) -> int:
        """Value, or mask of a field."""
        if n is not None:
            return self.values[self.call(name, n)]
        return self.values[f"{name}({ALL_ONES})" if self.parameters[name] else name]


@pytest.fixture(scope="module")
def chip() -> ChipDescription:
    return ChipDescription()


@pytest.fixture(scope="module")
def header(compile_program: CompileProgram, tmp_path_factory: pytest.TempPathFactory) -> Definitions:
    return Definitions(compile_program, tmp_path_factory.mktemp("registers"))


def prefix_of(name: str) -> str | None:
    """Prefix of the peripheral of a definition."""
    return next((prefix for prefix in PERIPHERALS if name.startswith(f"{prefix}_")), None)


def mask(field: tuple[int, int]) -> int:
    return ((1 << field[1]) - 1) << field[0]


def having(chip: ChipDescription, prefix: str, register: str) -> dict[str, Register]:
    """A register in each peripheral of a prefix that has it."""
    found = {p: chip.registers(p).get(register) for p in PERIPHERALS[prefix]}
    return {p: r for p, r in found.items() if r is not None}


def test_every_peripheral_has_its_address(chip: ChipDescription, header: Definitions) -> None:
    names = [name.removesuffix("_BASE") for name in header.parameters if name.endswith("_BASE")]
    assert len(names) > 20
    for name in names:
        (peripheral,) = PERIPHERALS.get(name, (name,))
        assert header.value(f"{name}_BASE") == chip.base(peripheral), name


def svd_register(name: str, n: int | None) -> tuple[str, str]:
    """Prefix and name of a register in the description."""
    prefix = prefix_of(name)
    assert prefix is not None
    return prefix, renamed(name, n, name.removeprefix(f"{prefix}_"))


def renamed(name: str, n: int | None, plain: str) -> str:
    """Name in the description: with its number, or another one, or the plain one."""
    if name in INDEXED:
        assert n is not None
        return INDEXED[name][0](n)
    return RENAMED.get(name) or plain


def numbers_of(name: str) -> list[int | None]:
    return list(INDEXED[name][1]) if name in INDEXED else [None]


def test_every_register_is_at_its_offset(chip: ChipDescription, header: Definitions) -> None:
    assert len(header.registers) > 90
    for name in header.registers:
        for n in numbers_of(name):
            prefix, register = svd_register(name, n)
            offsets = {r.offset for r in having(chip, prefix, register).values()}
            assert offsets == {header.value(name, n)}, f"{name} {n}"


def test_every_field_is_where_the_description_has_it(chip: ChipDescription, header: Definitions) -> None:
    assert len(header.fields) > 150
    for name in header.fields - BY_BITS - SAMPLE_TIMES:
        owner = header.register_of(name)
        for n in numbers_of(name):
            prefix, register = svd_register(owner, n if n is not None else numbers_of(owner)[0])
            field = renamed(name, n, name.removeprefix(f"{owner}_"))
            found = {p: r.fields.get(field) for p, r in having(chip, prefix, register).items()}
            if prefix == "TIM":  # the others have fewer
                found = {p: place for p, place in found.items() if place or p in ADVANCED}
            masks = {mask(place) if place else None for place in found.values()}
            assert masks == {header.value(name, n)}, f"{name} {n}"


def test_every_code_fits_in_its_field(header: Definitions) -> None:
    assert len(header.codes) > 50
    for name in header.codes:
        owner = header.register_of(name)
        fields = [f for f in header.fields if f.startswith(f"{owner}_") and header.parameters[f]]
        named = [f for f in fields if name.startswith(f"{f}_")] or fields
        numbers = {
            f: numbers_of(f)[0] if f in INDEXED else header.special_numbers(f)[0]
            for f in named
            if len(header.parameters[f]) == 2
        }
        widths = [bin(header.value(f, numbers.get(f))).count("1") for f in named]
        assert header.value(name) < 1 << min(widths, default=32), name
        assert widths or owner in ("FLASH_KEYR", "IWDG_KR"), name


def test_fields_that_the_description_splits(chip: ChipDescription, header: Definitions) -> None:
    for name in BY_BITS:
        register, field = name.removeprefix("RCC_").split("_")
        fields = chip.registers("RCC")[register].fields
        bits = {f: place for f, place in fields.items() if re.fullmatch(rf"{field}\d", f)}
        assert bits
        assert sum(mask(place) for place in bits.values()) == header.value(name), name
    for channel in range(19):
        name, first = ("ADC_SMPR1_SMP", 10) if channel >= 10 else ("ADC_SMPR2_SMP", 0)
        assert header.value(name, channel) == 7 << 3 * (channel - first)


def test_every_interrupt_has_its_number(chip: ChipDescription, header: Definitions) -> None:
    names = [name.removeprefix("IRQ_") for name in header.parameters if name.startswith("IRQ_")]
    assert names
    for name in names:
        assert chip.interrupts[name] == {header.value(f"IRQ_{name}")}, name
    assert header.value("IRQS") == 1 + max(max(numbers) for numbers in chip.interrupts.values())


def test_every_pin_has_its_function(chip: ChipDescription, header: Definitions) -> None:
    functions = [re.fullmatch(r"AF_([A-D])(\d+)_(\w+)", name) for name in header.parameters if name.startswith("AF_")]
    assert len(functions) > 20
    for found in functions:
        assert found is not None
        port, pin, function = found.groups()
        assert int(chip.pin_functions(port, int(pin))[function]) == header.value(found[0]), found[0]


def test_every_analogue_pin_reaches_its_converters(chip: ChipDescription, header: Definitions) -> None:
    inputs = [re.fullmatch(r"ADC(\d+)_IN_([A-D])(\d+)", name) for name in header.parameters if "_IN_" in name]
    assert len(inputs) == 7
    for found in inputs:
        assert found is not None
        converters, port, pin = found.groups()
        expected = {f"ADC{converter}": header.value(found[0]) for converter in converters}
        assert chip.converter_inputs(port, int(pin)) == expected, found[0]


def test_every_request_of_dma_has_its_channel(chip: ChipDescription, header: Definitions) -> None:
    requests = [re.fullmatch(r"DMA(\d)_S(\d)_(\w+)", name) for name in header.parameters if re.match(r"DMA\d_S", name)]
    assert requests
    for found in requests:
        assert found is not None
        controller, stream, request = found.groups()
        assert chip.dma_requests(int(controller), int(stream))[request] == header.value(found[0]), found[0]


def test_core_and_memories(chip: ChipDescription, header: Definitions) -> None:
    assert header.value("SCB_VTOR") == chip.core_register("VTOR")
    memories = {name: (address, size) for name, address, size in chip.memories()}
    for name, described in (("FLASH", "flash"), ("SRAM1", "sram1"), ("SRAM2", "sram2"), ("CCM", "ccm")):
        assert (header.value(f"{name}_MEMORY"), header.value(f"{name}_MEMORY_SIZE")) == memories[described]
    end = header.value("FLASH_MEMORY")
    for sector in range(header.value("FLASH_SECTORS")):
        assert header.value("FLASH_SECTOR_ADDRESS", sector) == end
        end += header.value("FLASH_SECTOR_SIZE", sector)
    assert end == sum(memories["flash"])


def test_nothing_is_left_out(header: Definitions) -> None:
    """Every definition belongs to one of the tests."""
    others = ("AF_", "IRQ_", "DMA1_", "DMA2_", "FLASH_MEMORY", "FLASH_SECTOR", "SRAM", "CCM", "SCB_")
    known = {*header.registers, *header.fields, *header.codes, *RENAMED}
    rest = {n for n in header.parameters if not n.startswith(others) and not n.endswith("_BASE") and "_IN_" not in n}
    assert rest <= known
