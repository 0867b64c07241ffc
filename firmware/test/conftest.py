"""Fixtures of the firmware tests: compilers, and FreeMASTER servers in a harness."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import common_rig  # noqa: F401
import pytest

# The helper modules of this folder can be imported under every import mode of pytest.
TEST = str(Path(__file__).resolve().parent)
if TEST not in sys.path:
    sys.path.insert(0, TEST)

from core_library import Core, load_core  # noqa: E402
from diagnosis_rig import Diagnosis  # noqa: E402
from firmware_compiler import CompileC, CompileProgram  # noqa: E402
from freemaster_board import CDEF, Board  # noqa: E402
from freemaster_model import COMM_SOURCES, SERVO, SHEET, Layout  # noqa: E402
from port_board import FakeBoard  # noqa: E402
from servo_bench import Bench  # noqa: E402


@pytest.fixture(scope="session")
def compile_c(tmp_path_factory: pytest.TempPathFactory) -> CompileC:
    """``compile_c(name, sources, cdef, defines=()) -> (ffi, lib)``: some C files as a library of the host."""
    return CompileC(tmp_path_factory.mktemp("lib"))


@pytest.fixture(scope="session")
def compile_program(tmp_path_factory: pytest.TempPathFactory) -> CompileProgram:
    """``compile_program(name, sources, options=(), defines=(), compiler="gcc") -> path``: an executable.

    Skips the test when the compiler is missing.
    """
    return CompileProgram(tmp_path_factory.mktemp("program"))


@pytest.fixture(scope="session")
def core(compile_c: CompileC) -> Core:
    """Complete firmware on a fake board."""
    return load_core(compile_c)


@pytest.fixture
def bench(core: Core) -> Bench:
    """A board with the first axis in SPIN."""
    bench = Bench(core)
    bench.to_spin(0)
    bench.slow(2)
    return bench


@pytest.fixture
def rig(compile_c: CompileC) -> Diagnosis:
    """The monitors of the diagnosis."""
    return Diagnosis(compile_c)


@pytest.fixture
def board(compile_c: CompileC) -> FakeBoard:
    """The port after its start, without the accesses of the start."""
    board = FakeBoard(compile_c)
    board.forget()
    return board


@pytest.fixture(scope="session")
def freemaster_sources(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Layout], list[str | Path]]:
    """Sources of a FreeMASTER server with its harness for one layout of the address space."""
    folder = tmp_path_factory.mktemp("layout")

    def sources(layout: Layout) -> list[str | Path]:
        table = folder / f"{layout.name}.c"
        table.write_text(layout.c_source(), encoding="ascii")
        return [*COMM_SOURCES, "test/freemaster_harness.c", table]

    return sources


@pytest.fixture(scope="session")
def new_board(
    compile_c: CompileC, freemaster_sources: Callable[[Layout], list[str | Path]]
) -> Callable[[Layout], Board]:
    """Creates a server for a layout."""

    def build(layout: Layout) -> Board:
        ffi, lib = compile_c(f"freemaster_{layout.name}", freemaster_sources(layout), CDEF, layout.defines)
        return Board(ffi, lib, layout)

    return build


@pytest.fixture
def sheet(new_board: Callable[[Layout], Board]) -> Iterator[Board]:
    """A server with the addresses and the buffer size of the byte examples of the protocol."""
    board = new_board(SHEET)
    yield board
    assert board.violations() == 0


@pytest.fixture
def servo(new_board: Callable[[Layout], Board]) -> Iterator[Board]:
    """A server with the addresses and the buffer size of the product."""
    board = new_board(SERVO)
    yield board
    assert board.violations() == 0


@pytest.fixture(scope="module")
def shared_servo(new_board: Callable[[Layout], Board]) -> Iterator[Board]:
    """As `servo`, shared by all examples of a property."""
    board = new_board(SERVO)
    yield board
    assert board.violations() == 0
