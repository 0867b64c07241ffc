"""A board that executes the ELF file of the firmware, against the board with the linked firmware."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from servo_twin.board import Board, BoardError, ChipError
from servo_twin.core_speed import CoreSpeed
from servo_twin.level import ELF_VARIABLE
from servo_twin.simulation import keep_set_points
from targets.sources import ROOT
from targets.toolchain import run

PORTS = ROOT / "firmware" / "port"
TIMELESS = replace(CoreSpeed.load(), cycles_per_instruction=1e-6, entry_cycles=0)
"""Instructions take no time: then both boards have the same bits."""
MS = 1_000_000
GET_TABLE = bytes.fromhex("2B 29 01 00 6C")  # FreeMASTER v4 GETTSAINFO of table 0

pytestmark = pytest.mark.usefixtures("cortex_m4_tools")


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], bytes]:
    """ELF file of the firmware with an optimisation."""
    built: dict[str, bytes] = {}

    def build(optimisation: str) -> bytes:
        if optimisation not in built:
            folder = tmp_path_factory.mktemp("elf")
            given = ["BOARD=mc56f84789_m4", f"OPT={optimisation}", f"BUILD={folder}"]
            run(["make", "--silent", "-j2", "-C", PORTS, *given])
            built[optimisation] = (folder / "servo.elf").read_bytes()
        return built[optimisation]

    return build


def move(board: Board) -> Board:
    """Search of both rotors, then a speed and a position."""
    keep_set_points(board)
    board.run(0.02)
    board.write("cmd.enable", [1, 1])
    board.advance(560 * MS)
    board.write("cmd.position", [3.0, -2.0])
    return board


@pytest.fixture
def board(elf: Callable[[str], bytes]) -> Iterator[Board]:
    with Board(seed=3, elf=elf("-O2")) as made:
        yield made


# ---- the same bits --------------------------------------------------------------------------------------------------


def test_snapshots_are_those_of_the_linked_firmware(elf: Callable[[str], bytes]) -> None:
    """Every bit of the telemetry and of the plant, for two optimisations, if instructions take no time."""
    results = []
    for program in (None, elf("-Os"), elf("-O2")):
        with move(Board(seed=3, core=TIMELESS, level="registers", elf=program)) as one:
            log = one.record(640 * MS)
            results.append((log.tobytes(), one.truth(0), one.truth(1)))
    assert results[1] == results[0]
    assert results[2] == results[0]


# ---- in time --------------------------------------------------------------------------------------------------------


def test_both_axes_move(board: Board) -> None:
    """From the reset vector, each instruction with its cycles, as the linked firmware and without a late loop."""
    with Board(seed=3, level="registers") as linked:
        for one in (board, linked):
            move(one).advance(1000 * MS)
        for axis in (0, 1):
            assert board.truth(axis).theta_m == pytest.approx(linked.truth(axis).theta_m, abs=0.01)
    assert board.read("late_loops") == 0


def test_serial_line_answers(board: Board) -> None:
    """The same bytes as the linked firmware."""
    with Board(seed=3, level="registers") as linked:
        answers = []
        for one in (linked, board):
            one.run(0.02)
            one.serial_in(GET_TABLE)
            one.run(0.02)
            answers.append(one.serial_out())
    assert answers[0]
    assert answers[0] == answers[1]


def test_state_continues_with_the_same_bits(elf: Callable[[str], bytes], board: Board) -> None:
    """At any instant, within a handler as well; not with another program."""
    move(board)
    for instant in (561_234_560, 561_250_010, 561_265_870, 562_000_000):
        board.advance(instant)
        state = board.state()
        assert state.time_ns - instant < 1000  # no handler is finished first
        with board.copy() as copy:
            copy.advance(570 * MS)
            ends = copy.state().image
        board.advance(570 * MS)
        assert board.state().image == ends
        board.restore(state)
    with Board(elf=elf("-Os")) as other, pytest.raises(BoardError, match="another program"):
        other.restore(state)


# ---- programs -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda elf: elf[:40], "no ELF file for 32-bit Arm"),
        (lambda elf: elf[:70_000], "incomplete"),
        (lambda elf: elf.replace(b"image_layout\0", b"image_layouT\0"), "a symbol is missing"),
    ],
    ids=["short", "incomplete", "another program"],
)
def test_wrong_file_is_refused(elf: Callable[[str], bytes], damage: Callable[[bytes], bytes], message: str) -> None:
    with pytest.raises(BoardError, match=message):
        Board(elf=damage(elf("-O2")))


def test_wrong_file_of_the_environment_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "junk.elf"
    path.write_bytes(b"junk")
    monkeypatch.setenv(ELF_VARIABLE, str(path))
    with pytest.raises(ValueError, match=r"junk\.elf: this is no ELF file"):
        Board(level="registers")


def test_file_needs_the_registers(elf: Callable[[str], bytes]) -> None:
    with pytest.raises(ValueError, match="level registers only"):
        Board(level="ideal", elf=elf("-O2"))


def symbol(path: Path, name: str) -> int:
    """Address of a function."""
    lines = run(["arm-none-eabi-nm", path]).splitlines()
    return next(int(line.split()[0], 16) for line in lines if line.split()[-1] == name)


def planted(elf: bytes, folder: Path, function: str, code: bytes) -> bytes:
    """The file with other instructions at the start of a function."""
    path = folder / "servo.elf"
    path.write_bytes(elf)
    at = symbol(path, function) & ~1
    text = run(["arm-none-eabi-objdump", "-h", path])
    fields = next(line.split() for line in text.splitlines() if " .text " in line)
    offset = int(fields[5], 16) + at - int(fields[3], 16)
    return elf[:offset] + code + elf[offset + len(code) :]


def test_an_undefined_instruction_stops_the_board(elf: Callable[[str], bytes], tmp_path: Path) -> None:
    message = r"undefined instruction.*\(instruction de00 at pc [0-9A-F]{8}h\)"
    with (
        Board(elf=planted(elf("-O2"), tmp_path, "port_m1", b"\x00\xde")) as wrong,
        pytest.raises(ChipError, match=message),
    ):
        wrong.run(0.01)


@pytest.mark.parametrize("function", ["hal_adc_select", "hal_adc_currents", "hal_pwm_duty"])
def test_a_planted_error_is_a_fault(elf: Callable[[str], bytes], tmp_path: Path, function: str) -> None:
    """A driver that does nothing: always the same ADC channels, no currents, always the same duties."""
    with move(Board(seed=3, elf=planted(elf("-O2"), tmp_path, function, b"\x70\x47"))) as wrong:
        wrong.advance(1000 * MS)
        assert wrong.read("axis1.faults") or wrong.read("axis2.faults")
