"""Descriptions of the STM32F405 that do not come from this project: SVD file, functions of pins, requests of DMA."""

from __future__ import annotations

import re
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import pytest

FOLDER: Final = Path(sys.prefix) / "chip-descriptions"
"""Where ``make`` installs them; they are only read."""


@dataclass(frozen=True)
class Register:
    """A register of a peripheral."""

    offset: int
    fields: dict[str, tuple[int, int]]  # lowest bit, width


class ChipDescription:
    """What the descriptions say about an STM32F405RG."""

    def __init__(self) -> None:
        if not FOLDER.is_dir():
            pytest.skip("there are no descriptions of the chip: `make .venv/.dev` installs them")
        with zipfile.ZipFile(FOLDER / "pyocd/debug/svd/svd_data.zip") as archive:
            # Of STM32F405, F407, F415 and F417 together.
            self._svd = ElementTree.fromstring(archive.read("STM32F41x.svd"))
        devices = FOLDER / "modm_devices/resources/devices/stm32"
        self._modm = ElementTree.parse(devices / "stm32f4-05_07_15_17.xml").getroot()
        self._debugger = (FOLDER / "pyocd/coresight/cortex_m.py").read_text(encoding="utf-8")

    @cached_property
    def peripherals(self) -> dict[str, ElementTree.Element]:
        """Peripherals of the SVD file by their names."""
        return {_text(p, "name"): p for p in self._svd.iterfind("peripherals/peripheral")}

    def base(self, peripheral: str) -> int:
        """Address of a peripheral."""
        return int(_text(self.peripherals[peripheral], "baseAddress"), 16)

    @lru_cache  # noqa: B019, one object in a run
    def registers(self, peripheral: str) -> dict[str, Register]:
        """Registers of a peripheral; a register with different fields for inputs and outputs has the fields of both."""
        element = self.peripherals[peripheral]
        element = self.peripherals[element.get("derivedFrom", peripheral)]
        found: dict[str, Register] = {}
        for register in element.iterfind("registers/register"):
            name = _text(register, "name").removeprefix("DBGMCU_").split("_Output")[0].split("_Input")[0]
            fields = {
                _text(f, "name"): (int(_text(f, "bitOffset")), int(_text(f, "bitWidth")))
                for f in register.iterfind("fields/field")
            }
            offset = int(_text(register, "addressOffset"), 16)
            found[name] = Register(offset, {**(found[name].fields if name in found else {}), **fields})
        return found

    @cached_property
    def interrupts(self) -> dict[str, set[int]]:
        """Numbers of each interrupt by all descriptions; they agree if there is one."""
        found: dict[str, set[int]] = {}
        for interrupt in self._svd.iterfind("peripherals/peripheral/interrupt"):
            found.setdefault(_text(interrupt, "name").removesuffix("_IRQ"), set()).add(int(_text(interrupt, "value")))
        for vector in self._modm.iter("vector"):
            found.setdefault(vector.attrib["name"], set()).add(int(vector.attrib["position"]))
        return {name.upper(): numbers for name, numbers in found.items()}

    def core_register(self, name: str) -> int:
        """Address of a register of the core."""
        found = re.search(rf"^    {name} = (0x\w+)", self._debugger, re.MULTILINE)
        assert found is not None, name
        return int(found[1], 16)

    def pin_functions(self, port: str, pin: int) -> dict[str, str]:
        """Code of the alternate function of each signal of a pin, such as ``{"TIM1_CH1": "1"}``."""
        (gpio,) = (
            g for g in self._modm.iter("gpio") if (g.attrib["port"], g.attrib["pin"]) == (port.lower(), str(pin))
        )
        return {_signal(s): s.attrib["af"] for s in gpio.iter("signal") if "af" in s.attrib}

    def converter_inputs(self, port: str, pin: int) -> dict[str, int]:
        """Channel of each converter that reaches a pin, such as ``{"ADC1": 10}``."""
        (gpio,) = (
            g for g in self._modm.iter("gpio") if (g.attrib["port"], g.attrib["pin"]) == (port.lower(), str(pin))
        )
        return {
            f"ADC{s.attrib['instance']}": int(s.attrib["name"].removeprefix("in"))
            for s in gpio.iter("signal")
            if s.attrib["driver"] == "adc"
        }

    def dma_requests(self, controller: int, stream: int) -> dict[str, int]:
        """Channel of each request of a stream, such as ``{"USART2_RX": 4}``."""
        (element,) = (
            s
            for group in self._modm.iter("streams")
            if group.attrib["instance"] == str(controller)
            for s in group.iter("stream")
            if s.attrib["position"] == str(stream)
        )
        return {
            _signal(signal): int(channel.attrib["position"])
            for channel in element.iter("channel")
            for signal in channel.iter("signal")
        }

    def memories(self) -> Iterator[tuple[str, int, int]]:
        """(name, address, bytes) of each memory of the chip with 1 MB of flash."""
        for memory in self._modm.iter("memory"):
            if memory.get("device-size", "g") == "g":
                yield memory.attrib["name"], int(memory.attrib["start"], 16), int(memory.attrib["size"])


def _text(element: ElementTree.Element, child: str) -> str:
    text = element.findtext(child)
    assert text is not None, child
    return text


def _signal(signal: ElementTree.Element) -> str:
    parts = signal.attrib["driver"] + signal.get("instance", ""), signal.get("name", "")
    return "_".join(part.upper() for part in parts if part)
