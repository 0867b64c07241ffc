"""Build recipe, stack and memory budget of the MC56F84789: complete, and within the available sizes."""

from __future__ import annotations

import shutil
from pathlib import Path

import chip_budget
import pytest
from chip_budget import INTERRUPT_WORDS, POINTERS, Budget, Program
from firmware_compiler import FIRMWARE
from port_board import PORT

pytestmark = pytest.mark.slow

STACK_MARGIN = 1.5  # stack frames of the chip's compiler are not known
LIBRARY_ROOM = 512  # words of the run-time library, which also runs from RAM
# Folders that are not flashed to the DSC.
OTHERS = {"test", "port/avr", "port/cortex_m3", "port/mc56f84789_m4", "port/arm", "port/stm32f405"}
FAST_ROOTS = (
    *("drive_current", "drive_observed", "encoder_source_fast", "observer_source_fast"),
    *("recorder_take", "adc_take_first", "adc_take_second", "port_receive"),
)
"""Functions executed in every period between the sample and the duties, and the receiver, which has a deadline."""


@pytest.fixture(scope="module")
def loaded() -> Program:
    if missing := chip_budget.missing_tools():
        pytest.skip(f"{', '.join(missing)} not installed")
    return chip_budget.load()


@pytest.fixture(scope="module")
def program(loaded: Program) -> Program:
    return chip_budget.resolve(loaded)


@pytest.fixture(scope="module")
def budget(program: Program) -> Budget:
    return chip_budget.budget(program)


@pytest.fixture
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A firmware of one file."""
    if missing := chip_budget.missing_tools():
        pytest.skip(f"{', '.join(missing)} not installed")
    monkeypatch.setattr(chip_budget, "FIRMWARE", tmp_path)
    return tmp_path / "alone.c"


def load(path: Path, text: str) -> Program:
    path.write_text(text, encoding="ascii")
    return chip_budget.resolve(chip_budget.load([path]))


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
class TestBuild:
    def test_every_source_of_the_firmware_is_compiled(self) -> None:
        files = {path.relative_to(FIRMWARE) for path in FIRMWARE.rglob("*.c")}
        expected = {path.as_posix() for path in files if not any(path.is_relative_to(folder) for folder in OTHERS)}
        assert {path.relative_to(FIRMWARE).as_posix() for path in chip_budget.sources()} == expected

    def test_sources_that_run_from_ram_are_sources_of_the_firmware(self) -> None:
        fast = chip_budget.fast_files()
        assert fast
        assert len(set(fast)) == len(fast)
        assert set(fast) <= {path.relative_to(FIRMWARE).as_posix() for path in chip_budget.sources()}

    def test_objects_in_the_data_flash_have_no_code(self, loaded: Program) -> None:
        """It also contains no data used by an interrupt, which would wait for the flash."""
        for name in chip_budget.table_files():
            assert loaded.code[name] == 0
            assert loaded.constants[name] > 0
            assert name not in chip_budget.fast_files()

    def test_each_object_is_compiled_from_one_source(self) -> None:
        """Each object has its own source and place; fast loops and tables are placed by their sections."""
        run = chip_budget._output("make", "--dry-run", "--always-make", "-C", PORT, "CW=/cw", "all")
        compiled = [line.split(" -c ")[1].split(" -o ") for line in run.splitlines() if " -c " in line]
        for source, target in compiled:
            name = target.removeprefix("build/").removesuffix(".o")
            ways = {"build/fast": chip_budget.fast_files(), "build/table": chip_budget.table_files()}
            way = next((way for way, files in ways.items() if f"{name}.c" in files), "../..")
            assert source == f"{way}/{name}.c"
        (link,) = [line for line in run.splitlines() if "mwld56800e" in line]
        assert sorted(target for _, target in compiled) == sorted(word for word in link.split() if word.endswith(".o"))
        assert len(compiled) == len(chip_budget.sources())


class TestFirmware:
    def test_the_stack_suffices_for_an_interrupt_of_each_level(self, budget: Budget) -> None:
        assert budget.deepest * STACK_MARGIN <= budget.stack, chip_budget.report(budget)

    def test_all_variables_fit_the_ram(self, budget: Budget) -> None:
        assert budget.free >= LIBRARY_ROOM, chip_budget.report(budget)

    def test_the_tables_fit_the_data_flash(self, budget: Budget) -> None:
        assert 0 < budget.tables <= chip_budget.DATA_FLASH_WORDS

    def test_the_fast_loops_run_from_ram(self, program: Program) -> None:
        files = {program.functions[key].file for key in program.reach(program.find(FAST_ROOTS))}
        assert files <= set(chip_budget.fast_files())

    def test_every_pointer_of_the_table_is_in_use(self, loaded: Program, program: Program) -> None:
        used = {call for one in loaded.functions.values() for call in one.calls if call.startswith("*")}
        assert used == {f"*{name}" for name in POINTERS}
        assert all(program.find(names) for names in POINTERS.values())


class TestTool:
    def test_levels_come_from_the_sources(self, program: Program, budget: Budget) -> None:
        handlers = [handler for found in chip_budget.levels().values() for handler in found]
        assert sorted(handlers) == sorted(
            one.name for one in program.functions.values() if one.name[:4] == "isr_" and one.name != "isr_unexpected"
        )
        for name, depth in budget.by_level.values():
            assert depth == INTERRUPT_WORDS + program.depth(name)
