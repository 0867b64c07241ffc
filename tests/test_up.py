"""``servo-up``: it starts all processes, prints instructions, and leaves no process or file."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import pytest
import yaml
from chain import DOMAIN, ros_user
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from servo_msgs_py.board_description import VARIABLE
from servo_msgs_py.run_file.reader import RunReader
from servo_msgs_py.run_file.run_info import run_info, string_of
from servo_msgs_py.runtime.claim import claimed
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_twin.level import ELF_VARIABLE, LEVEL_VARIABLE
from servo_twin.machine import SPEED_MIN, level_for, simulation_speed
from servo_twin.processes import Child, executable
from servo_twin.up import Stack, _run_file, main, parser
from servo_twin.view.layouts import plots
from servo_twin.view.scene import SET_POINT

from servo_twin import up as up_module
from servo_twin import virtual_board

pytestmark = pytest.mark.realtime

TIMEOUT = 60.0
MARK = "SERVO_UP_TEST_MARK"
MAIN = "import sys; from servo_twin.up import main; sys.exit(main())"
IDEAL = ("--level", "ideal")
"""Level with the lower CPU load."""
NOT_CONNECTED = """
from servo_twin import up
from servo_twin.processes import wait_until

def announce_from_no_port_on(stack):
    wait_until(lambda: any("does not exist" in child.text() for child in stack.children), stack.children, 60.0)
    return announce(stack)

up._PATIENCE, announce = 0.5, up.Stack.announce
up.Stack.announce = announce_from_no_port_on
"""
"""Patch: the time for the connection starts when the bridge reports the missing port, and is short."""
SLOW_BOARD = """
from servo_twin import up

start = up.Stack.start
up.Stack.start = lambda stack, name, *arguments: start(
    stack, name, *arguments, *(("--speed", "0.6") if name == "virtual_board" else ())
)
"""
"""Patch: board time runs at 0.6 of real time, as on a machine that is too slow."""
BOTH = ["axis1", "axis2"]


def descendants(mark: str) -> dict[int, str]:
    """Command lines of running processes that inherited the mark, with NUL after each word, by process id."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            marked = f"{MARK}={mark}".encode() in (entry / "environ").read_bytes().split(b"\0")
            line = (entry / "cmdline").read_text()
            if marked and line and int(entry.name) != os.getpid():
                found[int(entry.name)] = line
    return found


def left_behind(mark: str) -> list[str]:
    return list(descendants(mark).values())


class Up:
    """``servo-up`` as a process; `before` is Python code that it runs first."""

    def __init__(self, out: Path, *arguments: str, before: str = "") -> None:
        self.mark = out.as_posix()
        self.log = out / "up.log"
        program = [sys.executable, "-c", f"{before}\n{MAIN}"] if before else [str(executable("servo-up"))]
        with self.log.open("wb") as output:
            self.process = subprocess.Popen(
                with_parent_death_signal(
                    [*program, *IDEAL, "--no-web", "--domain-id", str(DOMAIN), "--out", str(out), *arguments]
                ),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, MARK: self.mark, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
                start_new_session=True,
            )

    def text(self) -> str:
        return self.log.read_text(errors="replace")

    def child(self, part: str) -> int:
        """Process id of the child with `part` in its command line."""
        return next(number for number, line in descendants(self.mark).items() if part in line)

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


class Given:
    """Takes the arguments of the children instead of starting them."""

    def __init__(self) -> None:
        self.words: dict[str, tuple[str, ...]] = {}

    def start(self, name: str, *words: str) -> str:
        self.words[name] = words
        return name

    def wait(self, *_: object) -> None: ...

    def expect(self, *_: object) -> None: ...


@pytest.mark.parametrize("name", ["-x", "~", "~nobody", "run #1", "a: [b]", "it's", "100%Y", "no", "1e3", "\u00fc"])
def test_names_of_files_reach_the_children_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [f"--{option}={name}" for option in ("plant", "thresholds", "record")]
    args, stack = parser().parse_args([*words, "--no-web"]), Given()
    up_module._start_all(cast(Stack, stack), args, tmp_path, args.record)
    path = tmp_path / name
    assert virtual_board._parser().parse_args(stack.words["virtual_board"]).plant == path
    given: dict[str, str] = {}
    for child in ("servo_twin", "servo_viewer"):
        assignments = [word.split(":=", 1) for word in stack.words[child] if ":=" in word]
        given |= {key: yaml.safe_load(value) for key, value in assignments}
    assert [given[key] for key in ("plant", "thresholds", "record")] == [str(path)] * 3


def test_processes_run_without_a_board_until_one_ends(started: list[Up], tmp_path: Path) -> None:
    up = Up(tmp_path, "--port", "/dev/ttyNoSuchPort", before=NOT_CONNECTED)
    started.append(up)
    up.wait_for("Ctrl-C ramps down")
    assert "no board on /dev/ttyNoSuchPort yet" in up.text()
    assert "the port /dev/ttyNoSuchPort does not exist" in up.text()
    os.kill(up.child("bin/servo_twin\0"), signal.SIGKILL)
    assert up.process.wait(30.0) == 1
    assert "servo_twin has ended with status -9" in up.text()
    assert "Traceback" not in up.text()
    assert left_behind(up.mark) == []


def test_demonstration_moves_records_and_draws_where_board_time_is_slow(tmp_path: Path) -> None:
    (tmp_path / "demo.png").write_text("of another run")
    program = [sys.executable, "-c", f"{SLOW_BOARD}\n{MAIN}"]
    result = subprocess.run(
        [*program, "--demo", *IDEAL, "--domain-id", str(DOMAIN), "--out", str(tmp_path)],
        env={**os.environ, MARK: str(tmp_path), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        capture_output=True,
        text=True,
        timeout=180.0,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "both axes reached their targets" in result.stdout
    figures = json.loads((tmp_path / "demo.json").read_text())
    assert figures["trouble"] is None
    assert figures["board_time_per_real_time"] < 0.65
    assert "board time ran at 0." in result.stdout
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")
    verify = [str(executable("rerun")), "rrd", "verify", str(tmp_path / "demo.rrd")]
    assert subprocess.run(verify, capture_output=True, check=False).returncode == 0
    run = RunReader(tmp_path / "demo.mcap")
    records = list(run.records())
    assert run.troubles == []
    assert {"/servo/snapshot", "/servo/commands_applied", "/twin/residual", "/rosout"} <= {
        each.topic for each in records
    }
    # A layout names what a recording has; only the set-points have to be asked for.
    curves = [curve for column in plots(["axis1", "axis2"]) for plot in column for curve in plot.curves]
    assert {curve.topic for curve in curves if curve.source != SET_POINT} <= {each.topic for each in records}
    info = run_info(string_of([each.data for each in records if each.topic == "/servo/run_info"][-1]))
    assert info.virtual_board is not None
    assert (info.virtual_board.level, info.virtual_board.seed, len(info.configuration)) == ("ideal", 1, 2)
    assert left_behind(str(tmp_path)) == []


def test_demonstration_on_another_board(tmp_path: Path) -> None:
    """Without an ELF file its firmware is linked, at level ideal; bridge and twin are of that board, too."""
    environment = {name: value for name, value in os.environ.items() if name not in (LEVEL_VARIABLE, ELF_VARIABLE)}
    result = subprocess.run(
        [str(executable("servo-up")), "--demo", "--domain-id", str(DOMAIN), "--out", str(tmp_path)],
        env={**environment, VARIABLE: "odrive36", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        capture_output=True,
        text=True,
        timeout=180.0,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "no ELF file of the firmware for the board odrive36 (--elf): level ideal" in result.stdout
    assert "connected to servo/odrive36" in result.stdout
    assert json.loads((tmp_path / "demo.json").read_text())["trouble"] is None


def test_old_recordings_of_sessions_are_removed(tmp_path: Path) -> None:
    for day in range(10, 20):
        for name in (f"up-202601{day}-120000.mcap", f"up-202601{day}-120000_1.mcap"):
            (tmp_path / name).touch()
    (tmp_path / "demo.mcap").touch()
    path = _run_file(parser().parse_args(["--out", str(tmp_path)]))
    assert path.name.startswith("up-20")
    sessions = {file.name.split("-")[1] for file in tmp_path.glob("up-*.mcap")}
    assert sessions == {f"202601{day}" for day in range(16, 20)}  # and this one
    assert _run_file(parser().parse_args(["--demo", "--out", str(tmp_path)])) == tmp_path / "demo.mcap"
    assert not (tmp_path / "demo.mcap").exists()


def test_folder_of_a_running_servo_up_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with claimed(tmp_path):
        assert main(["--out", str(tmp_path)]) == 1
    assert f"{tmp_path} is used by another running program" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("status", "drawn"), [(0, True), (1, False), (2, False)])
def test_a_failed_demonstration_leaves_no_picture(
    status: int, drawn: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, record = tmp_path / "demo.png", tmp_path / "demo.rrd"
    picture.write_text("of another run")
    monkeypatch.setattr(up_module, "_start_all", lambda *_: record.touch())
    monkeypatch.setattr(up_module, "_run_demo", lambda *_: status)
    monkeypatch.setattr(up_module, "_finish_demo", lambda *_: picture.write_text("new"))
    assert main(["--demo", *IDEAL, "--out", str(tmp_path)]) == status
    assert picture.exists() == drawn
    assert ("not complete; no picture" in capsys.readouterr().out) != drawn


def test_the_recording_is_checked_without_the_script_of_rerun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The script, which pip writes, fails in a folder with a quotation mark in its name."""
    rerun = pytest.importorskip("rerun")
    with rerun.RecordingStream("test") as stream:
        stream.save(record := tmp_path / "demo.rrd")
        stream.log("value", rerun.Scalars(1.0))
    monkeypatch.setattr(up_module, "executable", lambda _: Path("/bin/false"))
    monkeypatch.setattr("servo_twin.view.picture.draw", lambda *_: None)
    up_module._finish_demo(record, tmp_path)


@pytest.mark.parametrize(
    ("options", "speed", "boards", "level"),
    [
        ([], 1.9, 2, "ideal"),
        ([], 2.1, 2, "registers"),
        (["--port", "/dev/ttyUSB0"], 1.9, 1, "ideal"),
        (["--level", "registers"], 1.9, 0, "registers"),
    ],
)
def test_a_slow_machine_gets_the_fast_level(
    options: list[str],
    speed: float,
    boards: int,
    level: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    measured: list[int] = []

    def measure(_: str, count: int) -> float:
        measured.append(count)
        return speed

    environments: list[dict[str, str]] = []
    monkeypatch.delenv("SERVO_TWIN_LEVEL", raising=False)
    monkeypatch.setattr(up_module, "simulation_speed", measure)
    monkeypatch.setattr(up_module, "_refuse_second_bridge", lambda *_: None)
    monkeypatch.setattr(up_module, "_start_all", lambda stack, *_: environments.append(stack.environment))
    monkeypatch.setattr(up_module, "_wait_for_stop", lambda *_: signal.raise_signal(signal.SIGINT))
    assert main([*options, "--out", str(tmp_path)]) == 0
    assert environments[0]["SERVO_TWIN_LEVEL"] == level
    assert measured == [boards] * bool(boards)
    assert ("only 1.9 times as fast" in capsys.readouterr().out) == (level == "ideal")


def test_speed_of_the_machine_is_measured() -> None:
    assert simulation_speed("ideal", 2) > 1.0
    assert [level_for(speed) for speed in (SPEED_MIN, 0.99 * SPEED_MIN)] == ["registers", "ideal"]


def test_the_demonstration_never_moves_a_real_board(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--demo", "--port", "/dev/ttyUSB0"])
    assert end.value.code == 2
    assert "virtual board only" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--port", ""], "empty; give a device path"),
        (["--domain-id", "999"], "'999' is too large; write a whole number from 0 up to 232: a ROS domain"),
        (["--set", "param.features[0]=FOO"], "'FOO' is not a number or one of the names none, ANTI_WINDUP"),
        (["--set", "param.i_q_limit=9,9"], "outside 0.1 .. 4 A"),
    ],
)
def test_invalid_command_lines_are_refused(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "text", "reason"),
    [
        ("--plant", None, "No such file"),
        ("--plant", "[", "correct the TOML"),
        ("--twin-plant", "[axis1]\nr_s = -1\n", "r_s"),
        ("--thresholds", "x = 1\n", "thresholds.toml"),
        ("--robot", None, "no such file"),
        ("--robot", "<mujoco", "thresholds.toml: XML"),
        (
            "--robot",
            '<mujoco><custom><text name="servo.axis1" data="no"/></custom></mujoco>',
            "not in the model",
        ),
    ],
)
def test_files_are_checked_before_anything_is_started(
    option: str, text: str | None, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "thresholds.toml"
    if text is not None:
        path.write_text(text)
    assert main([option, str(path), "--out", str(tmp_path / "out")]) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_parameters_and_plant_are_passed_and_ctrl_c_ends_all_processes(started: list[Up], tmp_path: Path) -> None:
    plant = tmp_path / "plants #1: new" / "plant.toml"
    plant.parent.mkdir()
    plant.write_text("[axis1]\ninertia = 1.2e-5\n")
    options = ("--set", "param.features[0]=ANTI_WINDUP+FRICTION", "--set", "param.host_timeout=0.25")
    up = Up(tmp_path, *options, "--plant", str(plant))
    started.append(up)
    up.wait_for("Ctrl-C ramps down")
    assert "servo_bridge: connected" in up.text()
    assert "/servo/axis1/position" in up.text()
    children = descendants(up.mark)
    for name, argument in (("virtual_board", f"--plant={plant}"), ("servo_twin", f'plant:="{plant}"')):
        assert argument in children[up.child(f"bin/{name}\0")].split("\0")
    get = [str(executable("servo-command")), "get", "param.features[0]", "param.host_timeout"]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    done = subprocess.run(get, env=environment, capture_output=True, text=True, timeout=30.0, check=True)
    assert "param.features[0] = 17 (ANTI_WINDUP+FRICTION)" in done.stdout
    assert "param.host_timeout = 0.25 s" in done.stdout
    with ros_user() as user:
        user.until(user.connected, 30.0)
        user.enable_axes()
        user.joint_commands.publish(JointState(name=BOTH, position=[300.0, -300.0]))
        user.until(lambda: user.position_of(0) > 10.0)
        up.process.send_signal(signal.SIGINT)
        user.until(lambda: user.link_level() == DiagnosticStatus.ERROR)
        assert user.last("/servo/armed") is False
    assert up.process.wait(30.0) == 0
    assert left_behind(up.mark) == []
    assert "Traceback" not in up.text()


def test_sigterm_ends_the_demonstration_in_motion(started: list[Up], tmp_path: Path) -> None:
    up = Up(tmp_path, "--demo")
    started.append(up)
    up.wait_for("axis1 to +5 turns")
    up.process.send_signal(signal.SIGTERM)
    assert up.process.wait(30.0) == 128 + signal.SIGTERM, up.text()
    assert "Traceback" not in up.text()
    assert "stopping: outputs off" in up.text()
    assert left_behind(up.mark) == []


def test_ctrl_c_while_the_picture_is_drawn_leaves_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The children have been stopped before."""
    record = tmp_path / "demo.rrd"
    children: list[Child] = []

    def bring_up(stack: Stack, *_: object) -> None:
        record.touch()
        children.append(stack.start("sleep", "60"))

    def finish(*_: object) -> None:
        assert [child.running for child in children] == [False]
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(up_module, "_start_all", bring_up)
    monkeypatch.setattr(up_module, "_run_demo", lambda *_: 0)
    monkeypatch.setattr(up_module, "_finish_demo", finish)
    assert main(["--demo", "--out", str(tmp_path)]) == 130
    assert f"stopped; the recording is in {record}, the picture was not drawn" in capsys.readouterr().out
    assert record.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_is_a_normal_end_except_in_the_demonstration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    monkeypatch.setattr(up_module, "_refuse_second_bridge", lambda *_: None)
    monkeypatch.setattr(up_module, "_start_all", lambda *_: None)
    monkeypatch.setattr(up_module, "_wait_for_stop", lambda *_: signal.raise_signal(number))
    monkeypatch.setattr(up_module, "_run_demo", lambda *_: signal.raise_signal(number))
    assert main(["--out", str(tmp_path)]) == 0
    assert main(["--demo", "--out", str(tmp_path)]) == 128 + number
