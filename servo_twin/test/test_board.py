"""One board with the real firmware: time, variables, snapshots, serial line and plant."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.catalogue import Catalogue
from servo_twin.board import Board, BoardError
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable

from servo_twin import _build_native

pytestmark = pytest.mark.usefixtures("level")

SLOW_NS = 500_000
MS = 1_000_000
CLOCK_NS = 10  # of a chip with registers
SPIN = 3

GET_TABLE = bytes.fromhex("2B 29 01 00 6C")  # FreeMASTER v4 GETTSAINFO of table 0


@pytest.fixture
def board() -> Iterator[Board]:
    with Board(seed=1) as board:
        yield board


def session(board: Board) -> NDArray[np.void]:
    """Rows of a session with commands, a load and a request on the serial line."""
    enable(board)
    board.write("cmd.position", [3.0, -2.0])
    board.set_load(0, 0.02)
    board.serial_in(GET_TABLE)
    return board.record(board.time_ns + 300 * MS)


class TestTime:
    def test_shaft_without_commands_does_not_move(self, board: Board) -> None:
        assert board.time_ns == 0
        board.advance(123_456_789)
        assert board.time_ns == 123_456_789
        board.advance(5)
        assert board.time_ns == 123_456_789
        board.run(0.5e-9 * 2)
        assert board.time_ns == 123_456_790

    def test_one_snapshot_per_slow_tick(self, board: Board) -> None:
        log = board.record(100 * MS)
        assert list(log["tick"]) == list(range(8, 1601, 8))
        assert board.time_ns == 100 * MS
        assert board.record(50 * MS).size == 0
        assert board.record(101 * MS)["tick"].tolist() == [1608, 1616]


class TestVariables:
    def test_board_has_all_variables_of_the_catalogue(self, board: Board) -> None:
        assert set(board.addresses) == set(Catalogue.load().variables)
        assert board.read("catalogue_hash") == Catalogue.load().hash

    def test_write_and_read_in_si(self, board: Board) -> None:
        board.write("param.speed_limit", [100.0, 200.0])
        assert board.read("param.speed_limit") == pytest.approx([100.0, 200.0], rel=1e-6)
        board.write_raw("param.host_timeout", 1234)
        assert board.read_words("param.host_timeout") == [1234]
        assert board.read("param.host_timeout") == pytest.approx(0.617)

    @pytest.mark.parametrize(
        ("name", "raw"),
        [
            ("cmd.mode", [0, 9]),
            ("cmd.enable", [2, 1]),
            ("param.feedback", [9, 0]),
            ("param.monitor", [99, 0]),
            ("param.host_timeout", 0),
            ("param.faults_enabled", [1 << 30, 0]),
            ("cmd.position", [2**30 + 1, 0]),
        ],
    )
    def test_values_outside_the_range_of_a_variable_are_refused(
        self, board: Board, name: str, raw: int | list[int]
    ) -> None:
        before = board.read_words(name)
        with pytest.raises(BoardError, match=f"{name}: .* outside the range of the variable") as error:
            board.write_raw(name, raw)
        assert error.value.status == 0x97
        assert board.read_words(name) == before

    def test_refused_write_reports_variable_and_reason(self, board: Board) -> None:
        with pytest.raises(BoardError, match=r"axis1\.position: .*access denied") as error:
            board.write_raw("axis1.position", 1)
        assert error.value.status == 0x89
        with pytest.raises(BoardError, match="access denied"):
            board.read_memory(0xDEAD0000, 4)
        with pytest.raises(KeyError, match=r"did you mean .*cmd\.position"):
            board.read("cmd.positon")
        with pytest.raises(ValueError, match=r"param\.speed_limit"):
            board.write("param.speed_limit", [1e6, 1.0])
        with pytest.raises(ValueError, match="2 expected"):
            board.write("cmd.position", 1.0)

    def test_snapshot_rows_agree_with_read(self, board: Board) -> None:
        board.run(0.01)
        log = board.record(board.time_ns + SLOW_NS)
        assert log.size == 1
        for variable in board.catalogue.snapshot_variables():
            assert [int(log[variable.name][0])] == board.read_words(variable.name), variable.name
        si = board.si(log)
        assert si["u_dc"][0] == board.read("u_dc") == pytest.approx(24.0, abs=0.1)
        assert bytes(log[0].tobytes()) == board.read("snapshot")


class TestRepeatability:
    def test_runs_are_bit_identical(self) -> None:
        runs = []
        for _ in range(2):
            with Board(seed=7) as board:
                log = session(board)
                runs.append((log.tobytes(), board.serial_out(), board.truth(0), board.truth(1), board.time_ns))
        assert runs[0] == runs[1]

    def test_another_seed_gives_another_noise(self) -> None:
        with Board(seed=1) as first, Board(seed=2) as second:
            assert session(first).tobytes() != session(second).tobytes()

    def test_boards_are_independent(self) -> None:
        with Board(seed=3) as alone:
            expected = session(alone).tobytes()
        with Board(seed=3) as one, Board(seed=4) as other:
            enable(other)
            other.set_supply(30.0)
            assert session(one).tobytes() == expected

    def test_boards_run_in_threads(self) -> None:
        def run(seed: int) -> bytes:
            with Board(seed=seed) as board:
                return session(board).tobytes()

        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(run, [1, 2, 1, 2])) == [run(1), run(2)] * 2


class TestSerialLine:
    def test_a_request_is_answered_in_the_time_of_its_bytes(self, board: Board) -> None:
        byte_ns = round(1e10 / 115200)
        board.advance(10 * MS)
        assert board.serial_next_ns() is None
        assert board.serial_in(GET_TABLE) == len(GET_TABLE)
        assert board.serial_next_ns() == pytest.approx(10 * MS + byte_ns, abs=CLOCK_NS)
        board.advance(10 * MS + 6 * byte_ns - 1)
        assert board.serial_out() == b""
        answer = b""
        while (next_ns := board.serial_next_ns()) is not None:
            board.advance(next_ns)
            answer += board.serial_out()
        assert answer[:2] == bytes.fromhex("2B 40")  # success, a length byte follows
        # no pause before the answer, except for interrupts, the server, and the rounding of the baud rate to clocks
        busy = 40_000 if board.level == "registers" else 5_000
        assert board.time_ns == pytest.approx(10 * MS + (5 + len(answer)) * byte_ns, abs=busy)
        assert board.stats().serial_overruns == 0


class TestPlant:
    def test_truth_at_rest(self, board: Board) -> None:
        board.run(0.02)
        truth = board.truth(1)
        start = board.plant.drawn(seed=1).axes[1].theta_start
        assert (truth.theta_m, truth.omega_m, truth.i_q, truth.u_dc) == (start, 0.0, 0.0, 24.0)
        assert board.stats().watchdog_services == 40

    def test_position_set_point_is_reached(self, board: Board) -> None:
        enable(board)
        offsets = [board.truth(k).theta_m - float(board.read_words(f"axis{k + 1}.position")[0]) * math.tau / 4000
                   for k in (0, 1)]  # fmt: skip
        board.write("cmd.position", [math.pi, -math.pi])
        board.run(1.5)
        for axis, target in [(0, math.pi), (1, -math.pi)]:
            assert board.truth(axis).theta_m - offsets[axis] == pytest.approx(target, abs=0.02)

    def test_board_has_the_given_plant(self) -> None:
        with Board(PlantConfig.load().with_axis(0, theta_start=1.0).with_bus(u_source=20.0)) as board:
            board.run(0.01)
            assert board.truth(0).theta_m == 1.0
            assert board.read("u_dc") == pytest.approx(20.0, abs=0.1)


class TestLife:
    def test_closed_board_raises_an_error(self) -> None:
        board = Board()
        board.close()
        board.close()
        with pytest.raises(BoardError, match="closed"):
            board.run(0.1)

    @pytest.mark.parametrize("axis", [-1, 2])
    def test_axis_numbers_other_than_two_axes_are_refused(self, board: Board, axis: int) -> None:
        with pytest.raises(IndexError, match=r"0 \.\. 1"):
            board.truth(axis)

    @pytest.mark.parametrize("options", [{"seed": -1}, {"seed": 1 << 64}, {"baud": 0.0}])
    def test_impossible_options_are_refused(self, options: dict[str, float]) -> None:
        with pytest.raises(ValueError, match="is not within"):
            Board(**options)  # type: ignore[arg-type]


class TestBuildScript:
    def test_missing_firmware_gives_a_message(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        with pytest.raises(FileNotFoundError, match="checkout of the whole repository"):
            _build_native.firmware_sources(tmp_path_factory.mktemp("alone") / "firmware")
