"""``servo-command`` with a bridge and a fake board."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import pytest
from bridge_rig import DOMAIN, FAULT, SPIN, STOP, Rig
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from servo_bridge.client import CommandError, Commands
from servo_bridge.command import main
from servo_bridge.commander import Commander
from servo_bridge.set_points import Mode
from servo_bridge.wire.link_state import LinkState
from servo_msgs_py.answers import LEASE_TIMEOUT
from servo_msgs_py.convert import from_stamp
from servo_msgs_py.runtime.qos import command_qos
from trajectory_msgs.msg import JointTrajectory

from servo_bridge import motions
from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with Rig() as result:
        yield result


@pytest.fixture
def command(rig: Rig, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    """Runs a command while the board sends samples; returns exit status and output. `wait`: time-out of answers [s]."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))

    def run(*arguments: str, wait: float = 8.0) -> tuple[int, str, str]:
        capfd.readouterr()
        with rig.samples():
            status = main(["--wait", str(wait), *arguments])
        out, err = capfd.readouterr()
        return status, out, "".join(line for line in err.splitlines(True) if not line.startswith("["))  # the log

    return run


def test_parameters_are_set_and_read_back(rig: Rig, command: Command) -> None:
    rig.connect()
    rig.until(rig.parameters)
    status, out, err = command("set", "param.features[0]=DEAD_TIME+FRICTION", "param.i_q_limit=1,1.5")
    assert (status, err) == (0, "")
    assert "param.features[0] = 24 (DEAD_TIME+FRICTION)" in out
    status, out, _ = command("set", "param.features[1]=none")
    assert (status, out) == (0, "param.features[1] = 0 (none)\n")
    assert rig.parameters()["param.features"] == [24, 0]
    requested = rig.bridge.get_parameter("board_parameters").value
    assert requested == ["param.features[0]=DEAD_TIME+FRICTION", "param.i_q_limit=1,1.5", "param.features[1]=none"]
    status, out, _ = command("get")
    assert status == 0
    assert len(out.splitlines()) == len(rig.parameters())
    assert "param.features = 24, 0 (DEAD_TIME+FRICTION, none)" in out


def test_refusals_of_the_bridge_are_printed(rig: Rig, command: Command) -> None:
    one = [rig.link.catalogue["param.position_max"].to_raw(1.0)] * 2
    rig.link.parameters["param.position_max"] = one
    rig.connect()
    rig.until(lambda: rig.parameters().get("param.position_max") == one)
    status, out, err = command("set", "param.position_min[0]=2")
    assert (status, out) == (1, "")
    assert err.startswith(
        "servo-command: set was refused: parameter board_parameters: param.position_min[0] 1.99962 rad exceeds"
    )


def test_state_names_faults_and_limits(rig: Rig, command: Command) -> None:
    rig.connect(FAULT, SPIN)
    rig.link.values |= {"axis1.faults": 1 << 6, "axis2.limits": 1 << 4}
    rig.link.sample()
    rig.until(lambda: rig.state() == "axis1=FAULT axis2=RUN/SPIN")  # latched before: the state of another test
    rig.until(lambda: "HOST_SILENT" in rig.diagnosis("axis1").message)
    status, out, _ = command("state")
    rig.link.values |= {"axis1.faults": 0, "axis2.limits": 0}
    assert status == 0
    lines = out.splitlines()
    assert lines[0] == "axis1=FAULT axis2=RUN/SPIN"
    assert lines[2].startswith("    fault HOST_SILENT: no command and no keep-alive from the host within")
    assert lines[4].startswith("    at limit POSITION: a soft limit of the position holds the shaft back")


def test_state_prints_derating_of_current_limit_and_oscillation(rig: Rig, command: Command) -> None:
    rig.connect(SPIN, SPIN)
    assert command("set", "param.i_q_limit=4,4")[0] == 0
    rig.link.values |= {"axis2.winding_temperature": 118, "axis2.winding_current": 3, "axis2.oscillation": 236}
    rig.until(lambda: "derated to 75 %" in rig.diagnosis("axis2").message)
    status, out, _ = command("state")
    rig.link.values |= {"axis2.winding_current": 9, "axis2.oscillation": 0}
    rig.until(lambda: rig.diagnosis("axis2").level == b"\x00")
    assert status == 0
    assert "    winding at 118 deg C: current limit derated to 75 %" in out.splitlines()
    assert [line for line in out.splitlines() if "oscillation" in line] == [
        "    oscillation at 236 Hz since it was enabled"
    ]


def test_state_names_parameters_refused_by_the_board(rig: Rig, command: Command) -> None:
    rig.connect(STOP, STOP)
    rig.link.rejected_parameter = "param.over_speed"
    assert rig.set_parameter("board_parameters", ["param.over_speed[0]=300"])[0]
    rig.until_sampled(lambda: any("param.over_speed is" in text for text in rig.logs()))
    status, out, _ = command("state")
    rig.link.rejected_parameter = ""
    assert status == 0
    assert out.splitlines()[-1].startswith("  parameters: param.over_speed is 1.0")


def test_set_reports_a_parameter_refused_by_the_board(rig: Rig, command: Command) -> None:
    """The board refuses a value within the range of the bridge."""
    rig.connect(STOP, STOP)
    rig.link.rejected_parameter = "param.over_speed"
    status, _, err = command("set", "param.over_speed=310,310", wait=5.0)
    rig.link.rejected_parameter = ""
    assert status == 1
    assert err.startswith("servo-command: set failed: param.over_speed is ")
    assert "requested 310, 310 rad/s" in err


def test_commands_without_a_board_report_the_reason(rig: Rig, command: Command) -> None:
    rig.connect(STOP, STOP)
    rig.link.disconnect(LinkState.DISCONNECTED, "gone")
    rig.until(lambda: rig.state().startswith("DISCONNECTED"))
    status, _, err = command("disable")
    assert status == 1
    assert err.startswith("servo-command: disable was refused: not connected: gone")
    status, _, err = command("get")
    assert (status, "the board is not connected" in err) == (1, True)
    status, out, _ = command("set", "param.host_timeout=0.5")
    assert (status, out) == (0, "the board is not connected; the parameters are set after the connection\n")
    status, out, _ = command("state")
    assert (status, out.startswith("DISCONNECTED")) == (0, True)


def test_disable_does_not_report_success_for_a_board_that_is_lost(
    rig: Rig, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.connect(SPIN, SPIN)
    accepted = Commander._call_checked

    def lose(commander: Commander, *arguments: Any) -> str:
        text = accepted(commander, *arguments)
        rig.link.disconnect()
        return text

    monkeypatch.setattr(Commander, "_call_checked", lose)
    status, out, err = command("disable")
    assert (status, out) == (1, "")
    assert err == "servo-command: the board was lost before its outputs were off: gone; plug it in\n"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["position", "axis1=1", "axis1=2"], "axis1 is given twice"),
        (["position", "axis1=nan"], "'nan' is not a finite number; write a number of either sign [rad]"),
        (["position", "axis1"], "write JOINT=VALUE"),
        (["set", "param.features[0]=FOO"], "'FOO' is not a number or one of the names none, ANTI_WINDUP"),
        (["set", "cmd.enable[0]=1"], "cmd.enable is not a parameter"),
        (["get", "param.i_q_limt"], "did you mean param.i_q_limit"),
    ],
)
def test_wrong_command_lines_are_usage_errors(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert text in capsys.readouterr().err


def longest(times: list[float]) -> float:
    return max(later - sooner for sooner, later in pairwise(times))


def test_velocity_is_renewed_for_the_requested_time(
    rig: Rig, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.enable_axes()
    speed = rig.link.catalogue["axis1.speed"].to_raw(50.0)
    times: list[float] = []
    rounds: list[float] = []  # time of this process, which other load may delay
    sample = rig.link.sample

    def sample_and_note() -> None:
        rounds.append(time.monotonic())
        rig.link.values["axis1.speed"] = speed
        sample()

    monkeypatch.setattr(rig.link, "sample", sample_and_note)

    def taken(message: JointState) -> None:
        if list(message.velocity) == [50.0]:
            times.append(time.monotonic())

    rig.user.create_subscription(JointState, topics.JOINT_COMMANDS, taken, command_qos())
    begin = time.monotonic()
    status, out, err = command("velocity", "axis1=50", "--for", "1")
    assert (status, out[:15]) == (0, "done: axis1 at "), err
    assert time.monotonic() - begin >= 1.0
    # The command waits for the bridge, not for this subscriber, which may miss the first messages.
    assert len(times) >= 4
    assert times[-1] - times[0] <= 1.2
    assert longest(times) < 0.25 + longest(rounds)  # half of the time-out of the board
    assert len([name for name, *_ in rig.link.written if name == "cmd.speed"]) >= 2
    assert rig.link.written[-1] == ("cmd.speed", 0, (rig.link.catalogue["cmd.speed"].to_raw(50.0),))


@pytest.mark.parametrize("jump", [-3600, 3600])
def test_a_system_clock_that_is_set_changes_no_time_of_a_motion(
    rig: Rig, command: Command, monkeypatch: pytest.MonkeyPatch, jump: int
) -> None:
    """The stamps of the samples jump with it. The last velocity is the one that counts."""
    rig.link.values["axis1.speed"] = 0
    rig.enable_axes()
    stamps: list[int] = []

    def stamp_of(stamp: Time) -> int:
        stamps.append(from_stamp(stamp) + (jump * 1_000_000_000 if len(stamps) > 40 else 0))
        if len(stamps) == 30:
            rig.link.values["axis1.speed"] = rig.link.catalogue["axis1.speed"].to_raw(50.0)
        return stamps[-1]

    monkeypatch.setattr(motions, "from_stamp", stamp_of)
    monkeypatch.setattr(motions, "_MEAN", 0.05)
    status, out, err = command("velocity", "axis1=50", "--for", "3")
    assert len(stamps) > 45
    assert (status, out[:15]) == (0, "done: axis1 at "), err


@pytest.mark.parametrize("confirmed", [True, False])
def test_a_program_that_did_not_run_does_not_start_its_joints_again(
    rig: Rig, command: Command, monkeypatch: pytest.MonkeyPatch, confirmed: bool
) -> None:
    """It cannot know whether it was suspended or the computer was busy."""
    rig.link.values["axis1.speed"] = 0
    rig.enable_axes()
    renewed, send = Commands.repeat, Commands.send

    def late(self: Commands, message: JointState | JointTrajectory) -> None:
        renewed(self, message)
        if isinstance(message, JointState):  # not the stop
            time.sleep(LEASE_TIMEOUT)

    def send_or_lose(self: Commands, message: JointState | JointTrajectory, timeout: float) -> str:
        if isinstance(message, JointTrajectory) and not confirmed:
            raise CommandError("no answer")
        return send(self, message, timeout)

    monkeypatch.setattr(motions, "_SILENCE", 30.0)  # a busy computer
    monkeypatch.setattr(Commands, "repeat", late)
    monkeypatch.setattr(Commands, "send", send_or_lose)
    status, out, err = command("velocity", "axis1=50", "--for", "5")
    assert (status, out) == (1, "")
    seconds, cause = re.findall(r"this program did not run for ([0-9.]+) s: (.*)", err)[0]
    assert float(seconds) >= LEASE_TIMEOUT
    stop = "the joints have stopped" if confirmed else "the stop is not confirmed: no answer"
    assert cause == f"it was suspended, or the computer is too busy; {stop}"


@pytest.mark.parametrize("arguments", [("velocity", "axis1=50", "--for", "0.5"), ("position", "axis1=3")])
def test_set_point_that_is_not_reached_is_an_error(
    rig: Rig, command: Command, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    """The fake board takes the set-point and does not move."""
    monkeypatch.setattr(motions, "_STANDSTILL", 0.2)
    rig.link.values |= {"axis1.speed": 0, "axis1.position": 0}
    rig.enable_axes()
    status, out, err = command(*arguments)
    assert (status, out) == (1, "")
    assert "axis1 " in err
    assert "instead of 50 rad/s" in err or "3.0000 rad from its target" in err


def test_position_that_is_reached_is_done(rig: Rig, command: Command) -> None:
    rig.enable_axes()
    rig.link.values["axis1.position"] = rig.link.catalogue["axis1.position"].to_raw(3.0)
    status, out, err = command("position", "axis1=3")
    rig.link.values["axis1.position"] = 0
    assert (status, out, err) == (0, "done: axis1 at 3.0002 rad\n", "")


@pytest.mark.parametrize("event", ["fault", "refused"])
def test_set_point_that_ends_early_is_an_error(
    rig: Rig, command: Command, monkeypatch: pytest.MonkeyPatch, event: str
) -> None:
    rig.enable_axes()
    if event == "refused":
        status, out, err = command("velocity", "axis1=1e9")
        assert (status, out) == (1, "")
        assert err.startswith("servo-command: refused, no motion: joint_commands: velocity of axis1 is 1e+09 rad/s")
        return
    sample = rig.link.sample

    def fault_after_the_command() -> None:
        if any(name == "cmd.speed" for name, *_ in rig.link.written):
            rig.link.set_states(FAULT, SPIN)
        sample()

    monkeypatch.setattr(rig.link, "sample", fault_after_the_command)
    status, out, err = command("velocity", "axis1=5", "--for", "5")
    assert (status, out) == (1, "")
    assert "axis1" in err
    assert "FAULT" in err


@pytest.mark.parametrize(
    ("arguments", "number"),
    [  # which signal it is makes no difference: test_program.py
        (("velocity", "axis1=5", "--for", "30"), signal.SIGINT),
        (("effort", "axis1=0.01", "--for", "30"), signal.SIGTERM),
        (("position", "axis1=30"), signal.SIGHUP),
        (("move", "axis1=1", "--time", "4"), signal.SIGTERM),
        (("sine", "axis1", "--amplitude", "1", "--frequency", "1"), signal.SIGHUP),
        (("home", "axis1", "--method", "stop-positive"), signal.SIGINT),
    ],
)
def test_signal_stops_the_joints(
    rig: Rig,
    command: Command,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    number: signal.Signals,
) -> None:
    for name, value in (("speed", 300.0), ("acceleration", 4000.0), ("i_q", 2.0)):
        variable = rig.link.catalogue[f"param.{name}_limit"]
        rig.link.parameters[variable.name] = [variable.to_raw(value)] * 2
    rig.enable_axes()
    sample = rig.link.sample
    signals = iter([number])
    moving = {"cmd.speed", "cmd.i_q", "cmd.position", "cmd.points", "cmd.home"}

    def interrupt() -> None:
        if moving & {name for name, *_ in rig.link.written}:
            for each in signals:
                os.kill(os.getpid(), each)
        sample()

    monkeypatch.setattr(rig.link, "sample", interrupt)
    status, _, err = command(*arguments)
    assert status == 128 + number
    assert err == "stopped: axis1 at 0.0000 rad\n"
    # The change of the mode stops the axis; it follows a position in mode POSITION already.
    mode = Mode.TRAJECTORY if arguments[0] == "position" else Mode.POSITION
    assert rig.link.written[-1] == ("cmd.mode", 0, (mode,))


def test_check_of_the_state(rig: Rig, command: Command) -> None:
    rig.enable_axes()
    assert command("state", "--check")[::2] == (0, "")
    rig.link.set_states(STOP, STOP)

    def disarmed() -> bool:
        rig.link.sample()
        return not rig.armed()

    rig.until(disarmed)
    assert command("state")[::2] == (0, "")
    status, _, err = command("state", "--check")
    assert (status, err) == (1, "servo-command: not ready: set-points are not accepted (armed is false); call enable\n")
    rig.link.set_states(FAULT, SPIN)
    rig.link.values["axis1.faults"] = 1 << 6
    status, _, err = command("state", "--check")
    rig.link.values["axis1.faults"] = 0
    assert status == 1
    assert err.startswith("servo-command: not ready: servo/servo_bridge: axis1: HOST_SILENT")
    rig.link.disconnect()
    rig.until(lambda: rig.state().startswith("DISCONNECTED"))
    assert command("state", "--check")[::2] == (1, "servo-command: not ready: the board is not connected\n")


def test_shell_completes_the_command_line() -> None:
    """argcomplete runs the program with the line to complete, and reads the answers from file descriptor 8."""
    script = "import os; os.dup2(1, 8); from servo_bridge.command import main; main()"
    line = "servo-command vel"
    environment = os.environ | {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "IFS": "\n"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "velocity"
