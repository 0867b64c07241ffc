"""Estimates of stack and RAM of the MC56F84789 from other compilers: ``make chip-budget``.

There is no free compiler for the 56800EX. Therefore the firmware is compiled as for silicon by arm-none-eabi-gcc, for
the calls and the stack frame of each function, and by avr-gcc, whose int and pointers have 16 bits like on the chip.
Both are estimates; the allowances below are added, and the linker file has to reserve the result.

The analysis starts at the interrupt handlers of ``vectors.c``; their levels are in ``vectors.h`` and ``settings.h``.
For a call through a pointer, `POINTERS` contains its possible targets; a missing pointer is an error.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

FIRMWARE: Final = Path(__file__).resolve().parents[1]
CHIP: Final = FIRMWARE / "port" / "mc56f84789"
ARM: Final = ("arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-O2")
AVR: Final = ("avr-gcc", "-mmcu=atmega1284p", "-Os")
CALL_GRAPHS: Final = "-fcallgraph-info=su"

RAM_WORDS: Final = 0x4000
DATA_FLASH_WORDS: Final = 0x3800  # the remaining data flash is non-volatile storage
BYTES_PER_WORD: Final = 2
CALL_WORDS: Final = 2  # JSR pushes PC and SR
INTERRUPT_WORDS: Final = 64  # `interrupt alignsp saveall`: about 45 words of registers, alignment, PC and SR
LIBRARY_WORDS: Final = 32  # assumed frame of a function of the run-time library
CODE_ALLOWANCE: Final = 1.25  # words on the chip per halfword of Thumb-2, with `-opt speed`

POINTERS: Final[Mapping[str, tuple[str, ...]]] = {
    # axis_t.source: feedback from the encoder or the observer
    **{
        name: (f"encoder_source_{name}", f"observer_source_{name}")
        for name in ("fast", "slow", "edge", "reset", "resync")
    },
    "align": ("encoder_source_align",),
    # states, transitions and substates
    "run_table": (
        *("calib_fast", "calib_slow"),
        *("ready_fast", "ready_slow"),
        *("align_fast", "align_slow"),
        *("spin_fast", "spin_slow", "spin_observed_fast", "spin_estimate", "spin_check", "spin_test_signal_fast"),
        *("freewheel_fast", "freewheel_slow"),
        *("startup_fast", "startup_slow_state", "startup_estimate", "startup_check"),
        *("test_mode_fast", "test_slow", "test_estimate", "test_check", "test_mode_signal_fast"),
        *("track_offsets", "idle"),
    ),
    "state": ("state_fault", "state_init", "state_stop", "state_run"),
    "to_fault": ("off",),
    "state_machine.c:fault": ("state_fault",),
    "state_machine.c:run": ("state_run",),
    "state_machine.c:fault_init": ("fault_init",),
    "state_machine.c:init_stop": ("init_stop",),
    "state_machine.c:stop_run": ("stop_run",),
    "state_machine.c:run_stop": ("run_stop",),
    # the server and its application
    "lock": ("lock",),
    "accepts": ("accepts",),
    "written": ("written",),
    "nonce": ("nonce",),
    "level_to_write": ("level_to_write",),
    "app_command.c:run": ("app_command",),
    "freemaster.c:run": (
        *("read_memory", "write_memory", "read_memory_from_base", "read_scope", "set_scope", "send_app_command"),
        *("set_recorder", "get_recorder", "get_tsa_info", "get_string_length", "get_configuration"),
        *("get_app_command_status", "get_app_command_data", "challenge_client", "check_password"),
        *("exchange_pipe", "get_pipe"),
    ),
}
"""Possible target functions of a pointer, by its name in the source, or by file and name."""


class BudgetError(Exception):
    """The firmware contains a construct that the tool cannot analyse."""


@dataclass
class Function:
    """Compiler data of one function."""

    name: str
    file: str
    stack: int = 0  # [bytes]
    calls: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class Program:
    """All functions of the firmware by their compiler names, and the sizes of the files."""

    functions: Mapping[str, Function]
    code: Mapping[str, int]
    """Bytes of Thumb-2 by file."""
    constants: Mapping[str, int]
    """Bytes of read-only data by file; except for `table_files` and `program_table_files` they are in RAM."""

    def find(self, names: Collection[str]) -> set[str]:
        """Functions with these names.

        Raises
        ------
        BudgetError
            If there is none with one of the names.
        """
        found = {key: one.name for key, one in self.functions.items() if one.name in names}
        if missing := set(names) - set(found.values()):
            raise BudgetError(f"no function {', '.join(sorted(missing))}")
        return set(found)

    def reach(self, roots: Iterable[str]) -> set[str]:
        """These functions and all functions called from them, without the run-time library."""
        found: set[str] = set()
        pending = list(roots)
        while pending:
            key = pending.pop()
            if key in self.functions and key not in found:
                found.add(key)
                pending += self.functions[key].calls
        return found

    def depth(self, root: str) -> int:
        """Maximum stack of a call of this function [words].

        Raises
        ------
        BudgetError
            If there is a recursion.
        """
        known: dict[str, int] = {}

        def below(key: str, path: tuple[str, ...]) -> int:
            if key in path:
                raise BudgetError(f"recursion: {' -> '.join([*path, key])}")
            if key not in self.functions:
                return LIBRARY_WORDS
            if key not in known:
                one = self.functions[key]
                calls = max((below(call, (*path, key)) for call in one.calls), default=0)
                known[key] = CALL_WORDS + -(-one.stack // BYTES_PER_WORD) + calls
            return known[key]

        return below(root, ())


def makefile_list(target: str) -> list[str]:
    """File names without extension from a target of the makefile of the chip."""
    return _output("make", "--silent", "--no-print-directory", "-C", CHIP, target).split()


# ---- compilers -----------------------------------------------------------------------------------------------------


def sources() -> list[Path]:
    """All C files in the flash."""
    return [FIRMWARE / f"{name}.c" for name in makefile_list("list")]


def missing_tools() -> list[str]:
    """Required compilers that are not installed."""
    return [tool for tool in (ARM[0], AVR[0], "arm-none-eabi-objdump", "avr-size") if shutil.which(tool) is None]


def _compile(compiler: Sequence[str], options: Sequence[str], folder: Path, files: Iterable[Path]) -> list[Path]:
    objects = []
    environment = dict(os.environ)
    if CALL_GRAPHS in options:
        environment["CCACHE_DISABLE"] = "1"  # ccache does not cache them
    for path in files:  # different folders can contain files with the same name
        objects.append(folder / f"{path.parent.name}_{path.stem}.o")
        command = [*compiler, "-std=c99", f"-I{FIRMWARE}", *options, "-c", str(path), "-o", str(objects[-1])]
        subprocess.run(command, env=environment, check=True)
    return objects


def _output(*command: object) -> str:
    return subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True).stdout


def load(files: Sequence[Path] | None = None) -> Program:
    """Compile the firmware as for silicon with arm-none-eabi-gcc and read call graph and sizes."""
    paths = list(sources() if files is None else files)
    functions: dict[str, Function] = {}
    code: dict[str, int] = {}
    constants: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path, compiled in zip(paths, _compile(ARM, [CALL_GRAPHS], folder, paths), strict=True):
            _read_graph(compiled.with_suffix(".ci").read_text(encoding="ascii"), functions)
            sizes = re.findall(
                r"^ +\d+ \.(text|rodata)\S* +([0-9a-f]{8})", _output("arm-none-eabi-objdump", "-h", compiled), re.M
            )
            file = path.relative_to(FIRMWARE).as_posix()
            code[file] = sum(int(size, 16) for section, size in sizes if section == "text")
            constants[file] = sum(int(size, 16) for section, size in sizes if section == "rodata")
    return Program(functions, code, constants)


def _read_graph(text: str, functions: dict[str, Function]) -> None:
    """Nodes and edges of one file (`CALL_GRAPHS`)."""
    for title, name, file, size in re.findall(
        r'^node: \{ title: "([^"]+)" label: "(\S+?)\\n([^":]+):\d+:\d+\\n(\d+) bytes', text, re.MULTILINE
    ):
        functions[title] = Function(name.split(".")[0], Path(file).relative_to(FIRMWARE).as_posix(), int(size))
    for caller, target, where in re.findall(
        r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"(?: label: "([^"]+)")?', text, re.MULTILINE
    ):
        functions[caller].calls.add(pointer_at(where) if target == "__indirect_call" else target)


def pointer_at(where: str) -> str:
    """``*`` and the name of the pointer in a call at file:line:column."""
    path, line, column = where.rsplit(":", 2)
    text = Path(path).read_text(encoding="ascii").splitlines()[int(line) - 1][int(column) - 1 :]
    called = re.sub(r"\[[^]]*\]", "", text.split("(")[0])
    name = re.split(r"->|\.", called)[-1].strip()
    specific = f"{Path(path).name}:{name}"
    if specific in POINTERS:
        return f"*{specific}"
    if name in POINTERS:
        return f"*{name}"
    raise BudgetError(f"{where}: POINTERS does not contain {name}")


def resolve(program: Program) -> Program:
    """The same program with calls through pointers replaced by calls of their possible targets."""
    functions = {}
    for key, one in program.functions.items():
        targets = (program.find(POINTERS[call[1:]]) for call in one.calls if call.startswith("*"))
        plain = {call for call in one.calls if not call.startswith("*")}
        functions[key] = replace(one, calls=plain.union(*targets))
    return replace(program, functions=functions)


def data_words(files: Sequence[Path] | None = None) -> int:
    """Size of the variables on the chip [words], from avr-gcc."""
    with tempfile.TemporaryDirectory() as name:
        # The list of headers (-MD) spares ccache a run of the preprocessor (CCACHE_DEPEND in the Makefile).
        objects = _compile(AVR, ["-MD"], Path(name), sources() if files is None else files)
        rows = [line.split() for line in _output("avr-size", *objects).splitlines()[1:]]
    return -(-sum(int(row[1]) + int(row[2]) for row in rows) // BYTES_PER_WORD)


# ---- data from the sources -------------------------------------------------------------------------------------------


def levels() -> dict[int, list[str]]:
    """Interrupt handlers by interrupt level."""
    settings = (CHIP / "settings.h").read_text(encoding="ascii")
    numbers = {name: int(value) for name, value in re.findall(r"#define (LEVEL_\w+) (\d+)U", settings)}
    found: dict[int, list[str]] = {}
    text = (CHIP / "vectors.h").read_text(encoding="ascii")
    for level, handler in re.findall(r"V\(VECTOR_\w+, (LEVEL_\w+), port_(\w+)\)", text):
        found.setdefault(numbers[level], []).append(f"isr_{handler}")
    return found


def fast_files() -> list[str]:
    """Files with code in RAM."""
    return [f"{name}.c" for name in makefile_list("list-fast")]


def table_files() -> list[str]:
    """Files with tables in the data flash only."""
    return [f"{name}.c" for name in makefile_list("list-tables")]


def program_table_files() -> list[str]:
    """Files with tables in the program flash only."""
    return [f"{name}.c" for name in makefile_list("list-program-tables")]


def stack_words() -> int:
    """Stack size in the linker file."""
    text = (CHIP / "mc56f84789.cmd").read_text(encoding="ascii")
    return int(re.findall(r"__stack_size = (\w+);", text)[0], 16)


@dataclass(frozen=True)
class Budget:
    """Words of the chip's RAM."""

    background: int
    by_level: Mapping[int, tuple[str, int]]  # handler with the largest stack, and that stack including the interrupt
    code: int
    data: int
    constants: int
    stack: int  # reserved in the linker file
    tables: int  # in data flash

    @property
    def deepest(self) -> int:
        """Largest total stack: background, interrupted by the handler with the largest stack of each level."""
        return self.background + sum(depth for _, depth in self.by_level.values())

    @property
    def free(self) -> int:
        return RAM_WORDS - self.code - self.data - self.constants - self.stack


def budget(program: Program) -> Budget:
    """RAM use of the program."""
    by_level = {}
    for level, handlers in sorted(levels().items()):
        depths = {handler: INTERRUPT_WORDS + program.depth(handler) for handler in handlers}
        deepest = max(depths, key=lambda handler: depths[handler])
        by_level[level] = (deepest, depths[deepest])
    code = sum(program.code[name] for name in fast_files())
    tables = sum(program.constants[name] for name in table_files())
    program_tables = sum(program.constants[name] for name in program_table_files())
    return Budget(
        program.depth("main"),
        by_level,
        round(code / BYTES_PER_WORD * CODE_ALLOWANCE),
        data_words(),
        -(-(sum(program.constants.values()) - tables - program_tables) // BYTES_PER_WORD),
        stack_words(),
        -(-tables // BYTES_PER_WORD),
    )


def report(one: Budget) -> str:
    """Tables of the budget."""
    rows = [f"| background | `main` | {one.background} |"]
    rows += [f"| level {level} | `{name}` | {depth} |" for level, (name, depth) in one.by_level.items()]
    rows += [f"| all of them at once | | {one.deepest} of {one.stack} |"]
    ram = (("code that runs from RAM", one.code), ("variables", one.data), ("constants", one.constants))
    return "\n".join(
        ["| stack | deepest | words |", "|---|---|---:|", *rows, "", "| RAM | words |", "|---|---:|"]
        + [f"| {name} | {words} |" for name, words in (*ram, ("stack", one.stack), ("free", one.free))]
        + [f"| all | {RAM_WORDS} |", "", f"Tables in the data flash: {one.tables} of {DATA_FLASH_WORDS} words."]
    )


def main() -> int:
    """Print the tables."""
    if missing := missing_tools():
        print(f"needs {', '.join(missing)} (apt-get install gcc-arm-none-eabi gcc-avr binutils-avr)", file=sys.stderr)
        return 1
    print(report(budget(resolve(load()))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
