"""The core that executes programs for the Cortex-M4, against QEMU and published cycles."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest
from targets.arm_cases import Case, assembly, random_cases
from targets.machines import CORTEX_M4, QEMU_M4, ArmProgram, build_arm_simulator, build_cortex
from targets.sources import Sources
from targets.toolchain import TargetError, run

SEED = 1
PER_GROUP = 60
TIMEOUT = 60.0

pytestmark = pytest.mark.usefixtures("cortex_m4_tools")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("arm")


@dataclass(frozen=True)
class Referee:
    """A program, and its output in QEMU."""

    elf: Path
    lines: list[str]

    def differences(self, simulator: Path) -> list[int]:
        """Lines that differ with a core, or that it does not reach."""
        own = ArmProgram(self.elf, simulator).run(b"").split()
        return [k for k, line in enumerate(self.lines) if k >= len(own) or own[k] != line]


def _referee(elf: Path) -> Referee:
    return Referee(elf, run([*QEMU_M4, "-kernel", elf], timeout=TIMEOUT).split())


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return random_cases(SEED, PER_GROUP)


@pytest.fixture(scope="module")
def instructions(folder: Path, cases: list[Case]) -> Referee:
    table, sources = folder / "cases.S", Sources()
    table.write_text(assembly(cases), encoding="utf-8")
    files = [sources.native / "arm_cases.c", table]
    return _referee(build_cortex(sources, folder / "cases.elf", files, [*CORTEX_M4, "-O2"]))


@pytest.fixture(scope="module")
def interrupts(folder: Path) -> Referee:
    sources = Sources()
    files = [sources.native / "arm_interrupts.c"]
    return _referee(build_cortex(sources, folder / "interrupts.elf", files, [*CORTEX_M4, "-O2"]))


@pytest.fixture(scope="module")
def simulator(folder: Path) -> Path:
    """The core with the sanitizers."""
    place = folder / "simulator"
    place.mkdir()
    return build_arm_simulator(Sources(), place, ("-O1", "-fsanitize=undefined,address", "-fno-sanitize-recover=all"))


# ---- QEMU ------------------------------------------------------------------------------------------------------------


def test_instructions_have_the_results_of_qemu(instructions: Referee, simulator: Path, cases: list[Case]) -> None:
    """Registers, flags and memory, for random instructions of every group with twelve sets of operands each."""
    assert len(instructions.lines) == len(set(instructions.lines)) == len(cases)
    assert [str(cases[k]) for k in instructions.differences(simulator)] == []


def test_interrupts_have_the_order_of_qemu(interrupts: Referee, simulator: Path) -> None:
    """Priorities, nesting, masks, frames, and a request within an IT block."""
    assert len(interrupts.lines) == len(set(interrupts.lines))
    assert interrupts.differences(simulator) == []


@pytest.mark.parametrize(
    ("file", "before", "after", "referee"),
    [
        ("execute.c", "s->carry = (uint32_t)(wide >> 32);", "s->carry = a > result;", "instructions"),
        ("execute.c", "(a ^ result) & (b ^ result)", "(a ^ b) & (b ^ result)", "instructions"),
        ("exceptions.c", "nvic->priority[n] < best", "nvic->priority[n] <= best", "interrupts"),
        ("exceptions.c", "(s->primask != 0u) ? 0u : priority", "priority", "interrupts"),
    ],
    ids=["carry", "overflow", "priority", "mask"],
)
def test_a_wrong_core_differs(
    request: pytest.FixtureRequest, tmp_path: Path, file: str, before: str, after: str, referee: str
) -> None:
    sources = Sources().copy(tmp_path / "sources")
    path = sources.twin / "arm" / file
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1, f"{file} has changed: {before!r}"
    path.write_text(text.replace(before, after), encoding="utf-8")
    program: Referee = request.getfixturevalue(referee)
    wrong = build_arm_simulator(sources, tmp_path, ("-O0",))
    try:
        different = program.differences(wrong) != []
    except TargetError:
        different = True  # it ends in an error
    assert different


# ---- one program ----------------------------------------------------------------------------------------------------


def _run(folder: Path, simulator: Path, body: str) -> str:
    """Output of the core for a main program in assembly text."""
    text = f".syntax unified\n.thumb\n.text\n.global main\n.thumb_func\nmain:\n{body}\nmovs r0, #0\nbx lr\n"
    (folder / "body.S").write_text(text, encoding="utf-8")
    elf = build_cortex(Sources(), folder / "body.elf", [folder / "body.S"], [*CORTEX_M4, "-O2"])
    (folder / "image").write_bytes(b"")
    return run([simulator, elf, folder / "image"], merged=True)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("udf #7", r"undefined instruction, or one that is not modelled \(instruction de07 at pc [0-9A-F]{8}h\)"),
        (
            "ldr r0, =0x50000000\nldrh r1, [r0, #2]\nb 1f\n.ltorg\n1:",
            r"read of 2 bytes at 50000002h, where nothing is \(instruction 8841 at pc [0-9A-F]{8}h\)",
        ),
        ("movs r0, #0\nstr r0, [r0]", r"write to the program at 00000000h \(instruction 6000 at pc [0-9A-F]{8}h\)"),
        ("vmov s0, r0", r"undefined .* \(instruction ee00 0a10 at pc [0-9A-F]{8}h\)"),
        ("ldr r0, =0x20000001\nbx r0\n.ltorg", r"branch to 20000001h, where no program is .*"),
        ("ldr r0, =0x20000001\nldm r0, {r1, r2}\nb 1f\n.ltorg\n1:", r"unaligned read of several words at 20000001h .*"),
    ],
    ids=["undefined", "unmapped", "program", "floating point", "RAM", "unaligned"],
)
def test_errors_name_address_and_instruction(tmp_path: Path, simulator: Path, body: str, message: str) -> None:
    with pytest.raises(TargetError) as error:
        _run(tmp_path, simulator, f".fpu fpv4-sp-d16\n{body}")
    assert re.search(f"^arm: {message}$", str(error.value), re.MULTILINE), error.value


LOOPS = 1000


@pytest.mark.parametrize(
    ("body", "cycles"),
    [
        # Measured on an STM32F103 from RAM: four cycles.
        ("", 4),
        ("nop", 5),
        ("ldr r1, [sp]\nadds r1, #1", 4 + 3),
        ("ldr r1, [sp]\nldr r2, [sp, #4]", 4 + 3),
        ("ldr r1, [sp]\nstr r1, [sp]", 4 + 2),
        ("str r1, [sp]", 5),
        ("push {r1-r4}\npop {r1-r4}", 4 + 5 + 5),
        ("mla r1, r2, r3, r4\nsmull r1, r2, r3, r4", 4 + 3),
        ("mov r1, #-1\nmovs r2, #1\nudiv r1, r1, r2", 4 + 2 + 12),
        ("movs r1, #3\nmovs r2, #7\nudiv r1, r1, r2", 4 + 2 + 2),
        ("bl 2f\nb 3f\n2: bx lr\n3:", 4 + 9),
        ("cmp r0, #0\nit eq\naddeq r1, #1", 4 + 3),
    ],
)
def test_cycles_of_the_table(tmp_path: Path, simulator: Path, body: str, cycles: int) -> None:
    """Cycles of a loop with some instructions, and of its end."""

    def total(loops: int) -> int:
        begin, end = f"push {{r4, lr}}\nldr r0, ={loops}\n.balign 4\n1:", "subs r0, #1\nbhi 1b\npop {r4, lr}"
        text = _run(tmp_path, simulator, f"{begin}\n{body}\n{end}\nb 4f\n.ltorg\n4:")
        return int(re.findall(r"(\d+) cycles", text)[0])

    assert total(2 * LOOPS) - total(LOOPS) == cycles * LOOPS
