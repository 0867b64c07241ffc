"""``servo-up``: everything comes up, says how to use it, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from servo_msgs_py.runtime.end_with_parent import bound_to_us
from servo_twin.processes import executable
from servo_twin.up import main, parser

pytestmark = pytest.mark.realtime

TIMEOUT = 60.0
MARK = "SERVO_UP_TEST_MARK"


def domain() -> str:
    return str(101 + os.getpid() % 100)


def left_behind(mark: str) -> list[str]:
    """Command lines of living processes that inherited the mark."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            marked = f"{MARK}={mark}".encode() in (entry / "environ").read_bytes().split(b"\0")
            line = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        if marked and line and int(entry.name) != os.getpid():
            found.append(line.replace(b"\0", b" ").decode())
    return found


class Up:
    """``servo-up`` as a process."""

    def __init__(self, out: Path, *arguments: str) -> None:
        self.mark = out.as_posix()
        self.log = out / "up.log"
        with self.log.open("wb") as output:
            self.process = subprocess.Popen(
                bound_to_us(
                    [str(executable("servo-up")), "--no-web", "--domain-id", domain(), "--out", str(out), *arguments]
                ),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, MARK: self.mark, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
                start_new_session=True,
            )

    def text(self) -> str:
        return self.log.read_text(errors="replace")

    def wait_for(self, text: str) -> None:
        self.wait_until(lambda: text in self.text(), f"servo-up does not say {text!r}")

    def wait_until(self, holds: Callable[[], bool], complaint: str = "servo-up does not get there") -> None:
        deadline = time.monotonic() + TIMEOUT
        while not holds():
            assert self.process.poll() is None, f"servo-up has ended:\n{self.text()}"
            assert time.monotonic() < deadline, f"{complaint}:\n{self.text()}"
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(0.1)


@pytest.fixture
def started() -> Iterator[list[Up]]:
    ups: list[Up] = []
    yield ups
    for up in ups:
        if up.process.poll() is None:
            up.process.terminate()
            up.process.wait(30.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_comes_up_and_a_signal_ends_everything(started: list[Up], tmp_path: Path, number: signal.Signals) -> None:
    up = Up(tmp_path)
    started.append(up)
    up.wait_for("Ctrl-C ramps down")
    assert "bridge connected" in up.text()
    assert "/servo/axis1/position" in up.text()
    assert len(left_behind(up.mark)) >= 4  # itself, board, bridge, twin
    up.process.send_signal(number)
    assert up.process.wait(30.0) == 0
    assert left_behind(up.mark) == []


def test_a_child_that_dies_ends_everything_and_is_named(started: list[Up], tmp_path: Path) -> None:
    up = Up(tmp_path)
    started.append(up)
    up.wait_for("Ctrl-C ramps down")
    board = next(entry for entry in Path("/proc").glob("[0-9]*") if _is(entry, "virtual_board", up.mark))
    os.kill(int(board.name), signal.SIGKILL)
    assert up.process.wait(30.0) == 1
    assert "virtual_board has ended" in up.text()
    assert left_behind(up.mark) == []


def _is(entry: Path, name: str, mark: str) -> bool:
    try:
        return name in (entry / "cmdline").read_text() and f"{MARK}={mark}" in (entry / "environ").read_text().split(
            "\0"
        )
    except OSError:
        return False


def test_a_port_without_a_board_is_said_and_everything_stays_up(started: list[Up], tmp_path: Path) -> None:
    up = Up(tmp_path, "--port", "/dev/ttyNoSuchPort")
    started.append(up)
    up.wait_for("Ctrl-C ramps down")
    assert "no board on /dev/ttyNoSuchPort yet" in up.text()
    assert "there is no port /dev/ttyNoSuchPort" in up.text()
    up.process.send_signal(signal.SIGINT)
    assert up.process.wait(30.0) == 0


def test_the_demonstration_moves_records_and_draws(tmp_path: Path) -> None:
    result = subprocess.run(
        [str(executable("servo-up")), "--demo", "--domain-id", domain(), "--out", str(tmp_path)],
        env={**os.environ, MARK: str(tmp_path), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        capture_output=True,
        text=True,
        timeout=180.0,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "both axes got there" in result.stdout
    figures = json.loads((tmp_path / "demo.json").read_text())
    assert figures["trouble"] is None
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")
    verify = [str(executable("rerun")), "rrd", "verify", str(tmp_path / "demo.rrd")]
    assert subprocess.run(verify, capture_output=True, check=False).returncode == 0
    assert left_behind(str(tmp_path)) == []


def test_the_demonstration_never_moves_a_real_board(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--demo", "--port", "/dev/ttyUSB0"])
    assert end.value.code == 2
    assert "virtual board only" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--port", ""], "it is empty"),
        (["--domain-id", "999"], "'999' is no ROS domain; they are 0 .. 232"),
        (["--set", "param.features[0]=FOO"], "'FOO' is not a number or one of the names none, ANTI_WINDUP"),
        (["--set", "param.i_q_limit=9,9"], "outside 0.1 .. 4 A"),
    ],
)
def test_wrong_command_lines(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    assert text in capsys.readouterr().err


def test_parameters_and_plant_reach_board_and_twin(started: list[Up], tmp_path: Path) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text("[axis1]\ninertia = 1.2e-5\n")
    options = ("--set", "param.features[0]=ANTI_WINDUP+FRICTION", "--set", "param.host_timeout=0.25")
    up = Up(tmp_path, *options, "--plant", str(plant))
    started.append(up)
    up.wait_for("Ctrl-C ramps down")
    for name, argument in (("virtual_board", str(plant)), ("servo_twin", f"plant:={plant}")):
        entry = next(entry for entry in Path("/proc").glob("[0-9]*") if _is(entry, f"bin/{name}\0", up.mark))
        assert argument in (entry / "cmdline").read_text().split("\0")
    get = [str(executable("servo-command")), "get", "param.features[0]", "param.host_timeout"]
    environment = {**os.environ, "ROS_DOMAIN_ID": domain(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    done = subprocess.run(get, env=environment, capture_output=True, text=True, timeout=30.0, check=True)
    assert "param.features[0] = 17 (ANTI_WINDUP+FRICTION)" in done.stdout
    assert "param.host_timeout = 0.25 s" in done.stdout


@pytest.mark.parametrize("when", ["while it moves", "while it draws"])
def test_ctrl_c_ends_the_demonstration(started: list[Up], tmp_path: Path, when: str) -> None:
    up = Up(tmp_path, "--demo")
    started.append(up)
    if when == "while it moves":
        up.wait_for("axis1 to +5 turns")
    else:
        up.wait_for("both axes got there")
        up.wait_until(lambda: len(left_behind(up.mark)) == 1)  # alone: the picture is drawn for seconds
    up.process.send_signal(signal.SIGINT)
    assert up.process.wait(30.0) == 130, up.text()
    assert "Traceback" not in up.text()
    assert "stop" in up.text()
    assert left_behind(up.mark) == []


def test_help_names_every_option() -> None:
    text = parser().format_help()
    for option in (
        "--port",
        "--baud",
        "--seed",
        "--no-web",
        "--record",
        "--domain-id",
        "--set",
        "--demo",
        "--out",
        "--twin-plant",
        "--thresholds",
    ):
        assert option in text
