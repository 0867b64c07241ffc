"""The board on a pseudo-terminal: pacing with a simulated clock, the terminal, and the whole program."""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from servo_msgs_py.runtime.claim import claimed
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_twin.virtual_board import IDLE_SLICE_S, LinkError, Pacer, Terminal, main, serve, slip_reporter

pytestmark = pytest.mark.realtime

MS = 1_000_000
GET_TABLE = bytes.fromhex("2B 29 01 00 6C")  # FreeMASTER v4 GETTSAINFO of table 0
TIMEOUT_S = 20.0


class TestPacer:
    def test_pacer_follows_the_clock_from_its_start(self) -> None:
        pacer = Pacer(1000 * MS, sim_ns=5 * MS)
        assert pacer.target(1000 * MS, 5 * MS) == 5 * MS
        assert pacer.target(1007 * MS, 5 * MS) == 12 * MS
        assert (pacer.slips, pacer.slipped_s) == (0, 0.0)

    def test_deadlines_are_absolute(self) -> None:
        """Being late once does not move the later deadlines."""
        pacer = Pacer(0)
        reached = 0
        for now in (3 * MS, 21 * MS, 22 * MS, 60 * MS):
            reached = pacer.target(now, reached)
            assert reached == now

    def test_the_pacer_follows_its_speed_factor(self) -> None:
        pacer = Pacer(0, speed=0.25)
        assert pacer.target(40 * MS, 0) == 10 * MS
        assert pacer.delay(40 * MS, 11 * MS) == pytest.approx(0.004)
        assert Pacer(0, speed=20.0).target(2 * MS, 0) == 40 * MS

    def test_delay_until_a_simulated_time(self) -> None:
        pacer = Pacer(100 * MS)
        assert pacer.delay(101 * MS, 4 * MS) == pytest.approx(0.003)
        assert pacer.delay(101 * MS, 1 * MS) == 0.0
        assert pacer.delay(101 * MS, 0) == 0.0

    def test_speed_changes_pauses_and_steps(self) -> None:
        pacer = Pacer(0)
        pacer.set_speed(10 * MS, 0.5)
        assert pacer.target(20 * MS, 10 * MS) == 15 * MS
        pacer.set_speed(20 * MS, 0.0)
        assert pacer.target(9000 * MS, 15 * MS) == 15 * MS
        assert pacer.delay(9000 * MS, 16 * MS) == math.inf
        pacer.step(MS)
        assert pacer.target(9000 * MS, 15 * MS) == 16 * MS
        pacer.set_speed(9000 * MS, 2.0)
        assert pacer.target(9001 * MS, 16 * MS) == 18 * MS
        assert pacer.slips == 0

    def test_a_stall_slips_and_is_counted(self) -> None:
        pacer = Pacer(0, max_lag_s=0.05)
        assert pacer.target(50 * MS, 0) == 50 * MS
        assert pacer.slips == 0
        assert pacer.target(1050 * MS, 50 * MS) == 100 * MS  # no more than the largest backlog
        assert pacer.slips == 1
        assert pacer.slipped_s == pytest.approx(0.95)
        assert pacer.target(1060 * MS, 100 * MS) == 110 * MS  # then it follows the clock again

    def test_the_backlog_of_a_too_slow_machine_is_bounded(self) -> None:
        """Computing takes twice as long as the time it covers: the backlog stays bounded."""
        pacer = Pacer(0, max_lag_s=0.05)
        now = reached = 0
        for _ in range(200):
            target = pacer.target(now, reached)
            now += 2 * (target - reached) + MS
            assert target - reached <= 50 * MS
            reached = target
        assert pacer.slips > 10
        assert reached == pytest.approx(now / 2, rel=0.1)


class FakeBoard:
    """Bytes sent to it come back after a fixed simulated time."""

    def __init__(self, echo_ns: int = 3 * MS, room: int = 100) -> None:
        self.time_ns = 0
        self.echo_ns, self.room = echo_ns, room
        self.due: list[tuple[int, bytes]] = []
        self.received: list[tuple[int, bytes]] = []

    def advance(self, until_ns: int) -> None:
        self.time_ns = max(self.time_ns, until_ns)

    def serial_in(self, data: bytes) -> int:
        taken = data[: self.room]
        self.received.append((self.time_ns, taken))
        self.due.append((self.time_ns + self.echo_ns, taken))
        return len(taken)

    def serial_out(self) -> bytes:
        ready = [data for t, data in self.due if t <= self.time_ns]
        self.due = [(t, data) for t, data in self.due if t > self.time_ns]
        return b"".join(ready)

    def serial_next_ns(self) -> int | None:
        return min((t for t, _ in self.due), default=None)


class FakeLine:
    """A client that sends at given times; sleeping moves the clock."""

    def __init__(self, sends: list[tuple[int, bytes]], stall_ns: int = 0) -> None:
        self.now_ns = 0
        self.sends = sends
        self.stall_ns = stall_ns
        self.delays: list[float] = []
        self.written: list[tuple[int, bytes]] = []

    def clock(self) -> int:
        return self.now_ns

    def wait(self, timeout: float, *, readable: bool = True) -> bool:
        self.delays.append(timeout)
        end = self.now_ns + round(timeout * 1e9)
        if readable and self.sends and self.sends[0][0] <= end:
            self.now_ns = max(self.now_ns, self.sends[0][0])
            return True
        self.now_ns = end + self.stall_ns
        self.stall_ns = 0
        return False

    def read(self) -> bytes:
        return self.sends.pop(0)[1]

    def write(self, data: bytes) -> None:
        self.written.append((self.now_ns, data))


def run(board: FakeBoard, line: FakeLine, until_ns: int) -> Pacer:
    pacer = Pacer(0)
    serve(board, line, pacer, lambda: line.now_ns >= until_ns, clock_ns=line.clock)
    return pacer


class TestServe:
    def test_the_board_is_advanced_while_idle(self) -> None:
        board, line = FakeBoard(), FakeLine([])
        run(board, line, 100 * MS)
        assert board.time_ns == pytest.approx(100 * MS, abs=IDLE_SLICE_S * 1e9)
        assert max(line.delays) <= IDLE_SLICE_S

    def test_bytes_arrive_at_their_send_time_and_leave_at_their_due_time(self) -> None:
        board, line = FakeBoard(), FakeLine([(12_345_678, b"ab"), (31_000_000, b"c")])
        run(board, line, 60 * MS)
        assert board.received == [(12_345_678, b"ab"), (31_000_000, b"c")]
        assert line.written == [(15_345_678, b"ab"), (34_000_000, b"c")]

    def test_bytes_that_exceed_the_buffer_of_the_board_are_kept(self) -> None:
        board, line = FakeBoard(room=2), FakeLine([(1 * MS, b"abcde"), (1 * MS, b"fg")])
        run(board, line, 40 * MS)
        assert b"".join(data for _, data in board.received) == b"abcdefg"

    def test_a_stall_is_reported(self) -> None:
        board, line = FakeBoard(), FakeLine([], stall_ns=500 * MS)
        reported: list[int] = []
        pacer = Pacer(0)
        serve(
            board, line, pacer, lambda: line.now_ns >= 600 * MS,
            clock_ns=line.clock, on_slip=lambda p: reported.append(p.slips),
        )  # fmt: skip
        assert reported == [1]
        assert pacer.slipped_s == pytest.approx(0.5 - 0.05, abs=0.01)


class TestSlipReport:
    def reports(self, slips: list[tuple[float, float]], capsys: pytest.CaptureFixture[str]) -> list[str]:
        """Reports after slips, given as time and additional slipped time [s]."""
        clock = [0.0]
        pacer = Pacer(0)
        report = slip_reporter("registers", lambda: round(clock[-1] * 1e9))
        for now, slipped in slips:
            clock.append(now)
            pacer.slips += 1
            pacer.slipped_s += slipped
            report(pacer)
        return capsys.readouterr().err.splitlines()

    def test_report_contains_the_lost_time(self, capsys: pytest.CaptureFixture[str]) -> None:
        lines = self.reports([(0.1 * k, 0.04) for k in range(1, 251)], capsys)
        assert len(lines) == 3  # after 1, 11 and 21 s
        for line, lost in zip(lines, ("0.400 s in the last 1.0 s", *["4.000 s in the last 10.0 s"] * 2), strict=True):
            assert line.startswith("virtual_board: warning: the machine is too slow for a board at level registers")
            assert f"it lost {lost}" in line

    def test_a_single_stall_is_reported_with_the_next_one(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert self.reports([(0.5, 0.2)], capsys) == []
        (line,) = self.reports([(0.5, 0.2), (100.0, 0.8)], capsys)
        assert "it lost 1.000 s in the last 100.0 s; time slipped 2 times, 1.000 s in total" in line


def read_for(fd: int, size: int) -> bytes:
    """At least `size` bytes, within a bounded time."""
    data, end = b"", time.monotonic() + TIMEOUT_S
    while len(data) < size and time.monotonic() < end:
        if select.select([fd], [], [], 0.1)[0]:
            data += os.read(fd, 4096)
    return data


@contextlib.contextmanager
def opened(path: Path | str) -> Iterator[int]:
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # no other reader
        yield fd
    finally:
        os.close(fd)


class TestTerminal:
    def test_terminal_is_raw_in_both_directions(self) -> None:
        data = bytes(range(256))
        with Terminal() as line, opened(line.device) as client:
            line.write(data)
            assert read_for(client, 256) == data
            os.write(client, data)
            received = b""
            while len(received) < 256:
                assert line.wait(TIMEOUT_S)
                received += line.read()
            assert received == data
            assert line.read() == b""

    def test_terminal_accepts_successive_clients(self) -> None:
        with Terminal() as line:
            for k in range(3):
                with opened(line.device) as client:
                    os.write(client, b"%d" % k)
                    assert line.wait(TIMEOUT_S)
                    assert line.read() == b"%d" % k
                assert not line.wait(0.0)

    def test_unread_bytes_are_discarded_and_counted(self) -> None:
        with Terminal() as line:
            for _ in range(100):
                line.write(bytes(1000))
            assert 50_000 < line.lost < 100_000

    def test_link_exists_as_long_as_the_terminal(self, tmp_path: Path) -> None:
        link = tmp_path / "servo"
        with Terminal(link) as line:
            assert os.readlink(link) == line.device
        assert not link.is_symlink()
        assert list(tmp_path.iterdir()) == []

    def test_link_of_a_terminal_that_has_ended_is_replaced(self, tmp_path: Path) -> None:
        link = tmp_path / "servo"
        with Terminal() as reused:  # by another program, after that which made the link
            for device in ("/dev/pts/does-not-exist", reused.device):
                link.symlink_to(device)
                with Terminal(link) as line:
                    assert os.readlink(link) == line.device != device
                assert not link.is_symlink()

    def test_link_of_a_running_board_is_refused_and_stays(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        link = tmp_path / "servo"
        with Terminal(link) as line:
            assert main(["--link", str(link)]) == 2
            assert f"{link} is used by another running program" in capsys.readouterr().err
            assert os.readlink(link) == line.device

    def test_a_link_replaced_by_another_program_is_kept(self, tmp_path: Path) -> None:
        link = tmp_path / "servo"
        with Terminal(link):
            link.unlink()
            link.symlink_to("/dev/null")
        assert os.readlink(link) == "/dev/null"

    def test_files_and_other_links_are_not_overwritten(self, tmp_path: Path) -> None:
        file = tmp_path / "precious"
        file.write_text("data")
        to_file = tmp_path / "link"
        to_file.symlink_to(file)
        to_port = tmp_path / "port"
        to_port.symlink_to("/dev/null")
        for link, reason in [
            (file, "is not a link"),
            (tmp_path, "is not a link"),
            (to_file, f"is a link to {file}"),
            (to_port, "is a link to /dev/null"),
            (tmp_path / "no" / "servo", "folder does not exist"),
        ]:
            with pytest.raises(LinkError, match=reason):
                Terminal(link)
        assert file.read_text() == "data"
        assert to_file.is_symlink()


@contextlib.contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """The program itself, terminated at the end."""
    process = subprocess.Popen(
        with_parent_death_signal([sys.executable, "-m", "servo_twin.virtual_board", *arguments]),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=TIMEOUT_S)


def ask(client: int, timeout_s: float = TIMEOUT_S) -> bytes:
    """One complete answer (2Bh, status 40h, length, data, checksum), or its part received before the timeout.

    On the line 2Bh is doubled, except at the begin.
    """
    os.write(client, GET_TABLE)
    line, data, end = b"", b"", time.monotonic() + timeout_s
    while time.monotonic() < end and (len(data) < 3 or len(data) < 4 + data[2]):
        if select.select([client], [], [], 0.1)[0]:
            line += os.read(client, 64)
            data = line[:1] + line[1:].replace(b"++", b"+")
    return data


class TestProgram:
    @pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
    def test_program_answers_and_stops_on_a_signal(self, tmp_path: Path, stop: signal.Signals) -> None:
        link = tmp_path / "servo"
        with program("--link", str(link), "--baud", "1000000", "--seed", "4") as process:
            assert process.stdout is not None
            assert f"{link} -> /dev/pts/" in process.stdout.readline()
            answers = []
            for _ in range(2):  # a client that closes and opens again
                with opened(link) as client:
                    answers.append(ask(client))
            assert answers[0] == answers[1]
            assert answers[0][:2] == bytes.fromhex("2B 40")
            process.send_signal(stop)
            out, err = process.communicate(timeout=TIMEOUT_S)
            assert process.returncode == 0
            assert "stopped after" in out
            assert all("the machine is too slow" in line for line in err.splitlines()), err
        assert not link.is_symlink()

    def test_the_line_has_the_requested_baud_rate(self, tmp_path: Path) -> None:
        """Request and answer at 1200 baud take more than 100 ms; at 1 Mbaud they would take 0.2 ms."""
        link = tmp_path / "servo"
        with program("--link", str(link), "--baud", "1200") as process:
            assert process.stdout is not None
            process.stdout.readline()
            with opened(link) as client:
                begin = time.monotonic()
                answer = ask(client)
                wire = (len(GET_TABLE) + len(answer)) * 10 / 1200
                assert time.monotonic() - begin > 0.9 * wire

    def test_flushing_the_port_does_not_disturb_the_next_exchange(self, tmp_path: Path) -> None:
        """Flush in the middle of an answer, as pyserial does when it opens a port."""
        link = tmp_path / "servo"
        with program("--link", str(link), "--baud", "1200") as process:
            assert process.stdout is not None
            process.stdout.readline()
            with opened(link) as client:
                os.write(client, GET_TABLE)
                assert os.read(client, 1)
                termios.tcflush(client, termios.TCIOFLUSH)
                while select.select([client], [], [], 0.2)[0]:  # the rest of the answer
                    os.read(client, 64)
                answer = ask(client)
                assert answer[:2] == bytes.fromhex("2B 40")
                assert len(answer) == 4 + answer[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", "-3"], "seed -3"),
        (["--plant", "/nonexistent/plant.toml"], "No such file"),
        (["--link", "/nonexistent/servo"], "folder does not exist"),
        (["--link", "/dev/null"], "is not a link"),
    ],
)
def test_wrong_options_exit_with_2(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("size", "message"),
    [(0, "is no image of a flash"), (100, "is no image"), (10**12, "is no image"), (None, "is not a regular file")],
)
def test_file_that_is_no_flash_image_is_refused_without_reading_it_all(
    size: int | None, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "flash"
    if size is None:
        file.symlink_to("/dev/zero")
    else:
        file.touch()
        os.truncate(file, size)  # without the memory for it
    assert main(["--flash", str(file)]) == 2
    assert f"{file} {message}" in capsys.readouterr().err


def test_flash_file_of_a_running_board_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, other = tmp_path / "flash", tmp_path / "other"
    other.symlink_to(file)
    with claimed(file):
        assert main(["--flash", str(other)]) == 2
    assert f"{file} is used by another running program" in capsys.readouterr().err
    assert not file.exists()


@pytest.mark.parametrize("arguments", [["--speed", "0"], ["--speed", "nan"], ["--frobnicate"]])
def test_invalid_numbers_and_unknown_options_are_usage_errors(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2


def test_an_invalid_plant_file_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plant.toml"
    file.write_text("[axis1]\nr_s = -1\n")
    assert main(["--plant", str(file)]) == 2
    assert "axis1.r_s: -1 is too small" in capsys.readouterr().err


def test_help_names_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert all(option in text for option in ("--link", "--baud", "--seed", "--plant", "--speed"))
