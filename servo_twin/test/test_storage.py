"""The data flash of a virtual board at both levels: power failures at random instants, duration of a save."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pytest
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block, send_configuration
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.board_storage import begin_request, execute_request, read_storage, request_result
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_twin.board import Board

pytestmark = pytest.mark.usefixtures("level")

CATALOGUE: Final = Catalogue.load()
COMMANDS: Final = 3 + 4 + sum(v.count for v in parameters(CATALOGUE)) + 2 * len(AxisConfigTable.load())
"""Flash commands of a save: two sectors, the head, every number, the seal."""

Values = tuple[tuple[int, ...], ...]


class Kept:
    """A board with access to its parameters, configuration and flash."""

    def __init__(self, flash: bytes | None = None, seed: int = 0) -> None:
        self.board = Board(seed=seed, flash=flash)
        self.run(0.06)

    def __enter__(self) -> Kept:
        return self

    def __exit__(self, *exception: object) -> None:
        self.board.close()

    def run(self, seconds: float) -> None:
        self.board.run(seconds)

    def values(self) -> Values:
        named = tuple(tuple(self.board.read_words(v.name)) for v in parameters(CATALOGUE))
        return (*named, *(tuple(read_block(self.board, axis).values()) for axis in range(AXES)))

    def change(self, number: int) -> None:
        """Change a parameter and a member of the configuration."""
        self.board.write("param.speed_limit", [100.0 + number, 90.0])
        block = read_block(self.board, 1)
        send_configuration(self.board, {1: {**block, "position_gain": block["position_gain"] + number}})


@pytest.fixture
def kept() -> Iterator[Kept]:
    with Kept() as kept:
        yield kept


def test_power_failure_at_any_instant_of_a_save(kept: Kept) -> None:
    """At random instants of random commands, and at the instants before and after the seal."""
    random = np.random.default_rng(1)
    kept.change(1)
    execute_request(kept.board, "SAVE")
    before = kept.values()
    kept.change(2)
    after = kept.values()
    image = kept.board.flash_image()
    cuts = [(1, 0.0), (1, 0.001), (2, 0.999), (3, 0.5), (COMMANDS - 1, 1.0), (COMMANDS, 0.0), (COMMANDS, 0.5)]
    cuts += [(int(random.integers(1, COMMANDS + 1)), float(random.random())) for _ in range(25)]
    cuts += [(COMMANDS, 1.0)]
    seen = []
    for number, part in cuts:
        with Kept(image, seed=number) as board:
            board.change(2)
            assert board.values() == after
            board.board.cut_flash(number, part)
            begin_request(board.board, "SAVE")
            board.run(0.1)
            assert board.board.flash_state().dead
            flash_after = board.board.flash_image()
        with Kept(flash_after) as board:
            assert board.values() in (before, after), (number, part)
            seen.append(board.values() == after)
            state = read_storage(board.board)
            assert state.source == ("COPY_B" if seen[-1] else "COPY_A")
            assert bool(state.trouble) == (state.copies[1] == "DAMAGED")
    assert seen[-1], "the seal is complete"
    assert not any(seen[:-1]), "a partial seal is valid with a probability of 2^-32"


def test_a_power_failure_at_any_instant_ends_the_flash_command(kept: Kept) -> None:
    random = np.random.default_rng(2)
    for _ in range(12):
        with Kept() as board:
            begin_request(board.board, "SAVE")
            board.run(float(random.uniform(0.0, 0.05)))
            flash_after = board.board.cut_power()
            assert board.board.flash_image() == flash_after
            board.run(0.1)
            assert board.board.flash_image() == flash_after, "power is off"
        with Kept(flash_after) as board:
            assert read_storage(board.board).source == "BUILT_IN"


def test_loops_run_during_a_flash_command(kept: Kept) -> None:
    """The axes are enabled during the flash command."""
    token = begin_request(kept.board, "SAVE")
    kept.run(0.02)
    kept.board.write("cmd.enable", [1, 1])
    rows = kept.board.record(kept.board.time_ns + 30_000_000)
    assert list(np.diff(rows["tick"])) == [8] * (len(rows) - 1)
    assert kept.board.read("late_loops") == 0
    assert [kept.board.read(f"axis{n}.state") for n in (1, 2)] == [CATALOGUE.enums["state_t"]["RUN"]] * 2
    with pytest.raises(ValueError, match="moving or enabled"):
        request_result(kept.board, token)


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="the flash image has 5 bytes instead of 32896"):
        Board(flash=bytes(5))
