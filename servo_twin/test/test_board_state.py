"""The state of a board: every later bit is that of the original, in another board, process or file."""

from __future__ import annotations

import pickle
import random
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Final

import pytest
from servo_twin.board import Board, BoardError
from servo_twin.board_state import BoardState
from servo_twin.fault_injection import BadContact, CurrentNoise, EncoderGlitches
from servo_twin.simulation import keep_set_points

MS: Final = 1_000_000
SEARCHED: Final = 560 * MS  # both axes are under control
END: Final = 640 * MS
GET_TABLE: Final = bytes.fromhex("2B 29 01 00 6C")  # FreeMASTER v4 GETTSAINFO of table 0
SIZE_MAX: Final = 64_000  # [bytes], with idle lines

pytestmark = pytest.mark.usefixtures("level")


def moving(seed: int = 3) -> Board:
    """Board with both axes on the way, injected faults and bytes on the line in both directions."""
    board = Board(seed=seed)
    keep_set_points(board)
    board.run(0.02)
    board.write("cmd.enable", [1, 1])
    board.advance(SEARCHED)
    board.write("cmd.position", [12.0, -7.0])
    board.inject(BadContact(0, 0.2))
    board.inject(EncoderGlitches(1, "A", 200.0))
    board.serial_in(10 * GET_TABLE)
    return board


def image_at(board: Board, until_ns: int) -> bytes:
    board.advance(until_ns)
    return board.state().image


@pytest.fixture(scope="module")
def states() -> dict[str, list[BoardState]]:
    """States of a run at instants within it, at its end the last, by level."""
    return {}


@pytest.fixture
def run(level: str, states: dict[str, list[BoardState]]) -> list[BoardState]:
    if level not in states:
        with moving() as board:
            draw = random.Random(1)
            instants = sorted(draw.randrange(SEARCHED, END) for _ in range(12))
            taken = [board.state()]
            for instant in [*instants, END]:
                board.advance(instant)
                taken.append(board.state())
            states[level] = taken
    return states[level]


def test_each_state_of_a_run_leads_to_its_end(run: list[BoardState]) -> None:
    with Board(seed=99) as board:
        for state in reversed(run):
            board.restore(state)
            assert board.time_ns == state.time_ns
            assert image_at(board, END) == run[-1].image


def test_saving_does_not_change_the_run(run: list[BoardState]) -> None:
    with moving() as board:
        assert image_at(board, END) == run[-1].image


def test_copies_continue_independently(run: list[BoardState]) -> None:
    with Board() as board:
        board.restore(run[0])
        copy = board.copy()
        board.set_load(0, 0.05)
        board.clear_fault()
        assert image_at(copy, END) == run[-1].image
        assert image_at(board, END) != run[-1].image
        assert copy.plant == run[0].plant != board.plant


def test_a_copy_runs_the_same_build_of_the_firmware() -> None:
    with Board() as packaged:
        build = packaged.firmware._replace(file="another build")
    with Board(firmware=build) as board, board.copy() as copy:
        assert copy.firmware is build


def test_injected_faults_belong_to_the_state(run: list[BoardState]) -> None:
    with Board() as board, moving() as original:
        original.state()
        board.inject(CurrentNoise(0, 1.0))
        board.restore(run[0])
        for one in (board, original):
            one.clear_fault(BadContact(0, 0.2))
        assert image_at(board, END) == image_at(original, END)
        assert board.plant == original.plant


def test_another_process_continues_from_a_file(run: list[BoardState], tmp_path: Path) -> None:
    run[3].save(tmp_path / "state")
    program = (
        "import sys; from servo_twin.board import Board; from servo_twin.board_state import BoardState\n"
        "state = BoardState.load(sys.argv[1]); board = Board(level=state.level); board.restore(state)\n"
        f"board.advance({END}); sys.stdout.buffer.write(board.state().image)"
    )
    done = subprocess.run([sys.executable, "-c", program, tmp_path / "state"], capture_output=True, check=True)
    assert done.stdout == run[-1].image


def test_file_and_pickle_keep_everything(run: list[BoardState], tmp_path: Path) -> None:
    run[1].save(tmp_path / "state")
    assert BoardState.load(tmp_path / "state") == run[1] == pickle.loads(pickle.dumps(run[1]))


def test_damaged_file_is_refused(run: list[BoardState], tmp_path: Path) -> None:
    path = tmp_path / "state"
    run[0].save(path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(BoardError, match="state: not a complete state"):
        BoardState.load(path)


def test_damaged_byte_of_a_file_is_refused_or_has_no_effect(run: list[BoardState], tmp_path: Path) -> None:
    path = tmp_path / "state"
    run[0].save(path)
    whole = path.read_bytes()
    refused = 0
    for k in [*range(60), *range(60, len(whole) - 250, 401), *range(len(whole) - 250, len(whole))]:
        path.write_bytes(whole[:k] + bytes([whole[k] ^ 0x55]) + whole[k + 1 :])
        try:
            assert BoardState.load(path) == run[0]
        except BoardError as error:
            assert str(error).startswith(f"{path}: not a complete state")  # noqa: PT017
            refused += 1
    assert refused > 100


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda image: image[:-1], "incomplete or damaged"),
        (lambda image: image[:5000] + bytes([image[5000] ^ 1]) + image[5001:], "incomplete or damaged"),
        (lambda image: image[:8] + bytes([image[8] ^ 1]) + image[9:], "another build or level"),
        (lambda image: b"", "not the state of a board"),
    ],
)
def test_damaged_image_is_refused_and_changes_nothing(run, damage, message: str) -> None:  # type: ignore[no-untyped-def]
    with Board() as board:
        board.restore(run[0])
        with pytest.raises(BoardError, match=message):
            board.restore(replace(run[1], image=damage(run[1].image)))
        assert board.state() == run[0]


def test_state_of_the_other_level_is_refused(level: str, run: list[BoardState]) -> None:
    with (
        Board(level="ideal" if level == "registers" else "registers") as board,
        pytest.raises(BoardError, match="another build or level"),
    ):
        board.restore(run[0])


def test_no_state_while_samples_go_to_the_memory_of_the_host() -> None:
    with Board() as board:
        board.sample(0, [(board.catalogue["axis1.i_q"], 0)], 100)
        with pytest.raises(BoardError, match="end the sampling first"):
            board.state()
        board.end_sampling()
        board.state()


def test_size_with_idle_lines() -> None:
    with Board(level="ideal", flash=bytes(4 * (8192 + 32))) as board:
        board.run(0.1)
        assert len(board.state().image) <= SIZE_MAX
