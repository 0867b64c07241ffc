"""The demonstration: its moves on a simulated servo, its table, and its message without a servo."""

from __future__ import annotations

import itertools
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from bridge_rig import DOMAIN, SPIN, STOP, Rig
from numpy.typing import NDArray
from servo_bridge.client import CommandError
from servo_bridge.demo import Demo
from servo_bridge.demo_client import ServoClient
from servo_bridge.demo_report import passed
from servo_bridge.trajectory.path import Path as Motion
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import AppliedCommand

from servo_bridge import demo as demo_module
from servo_bridge import demo_client

TURN = 2.0 * math.pi
COUNT = TURN / 4000
STEP = 96  # PWM periods per sample, as at 115200 baud
SAMPLE = STEP / 16000  # s
SPEED = 250.0  # rad/s
STATES, SUBSTATES = (Catalogue.load().enums[name] for name in ("state_t", "substate_t"))


class FakeClient:
    """A servo in simulated time: position follows its set-point at constant speed."""

    def __init__(self, position: Sequence[float] = (0.3 * COUNT, -2.2 * COUNT), twin_gap: float = 0.0) -> None:
        self.joints = ["axis1", "axis2"]
        self.geared: list[str] = []
        self.connected = True
        self.state = "axis1=STOP axis2=STOP"
        self.applied: list[AppliedCommand] = []
        self.log: list[str] = []
        self.position = list(position)
        self.target = list(self.position)
        self.error = [0.0, 0.0]  # steady error
        self.path: Motion | None = None
        self.lost_paths = 0  # number of paths whose points reach the board for a second only
        self.refusals = 0  # number of refused paths
        self.rows: list[dict[str, float]] = []
        self.twin_present = True
        self.twin_state = ""
        self.twin_gap = twin_gap
        self.faults = 0
        self.fault_at: int | None = None
        self.ignores_commands = False
        self.tick = 0
        self._residuals: list[tuple[int, list[float]]] = []
        self._step()

    def _step(self) -> None:
        self.tick += STEP
        if self.fault_at is not None and self.tick >= self.fault_at:
            self.faults, self.state = 2, "axis1=FAULT axis2=RUN/SPIN"
        row = {"tick": float(self.tick)}
        if self.path is not None:
            elapsed = self.tick / 16000 - self.path.start_time
            if not (self.lost_paths and elapsed > 1.0):
                self.target = list(self.path.state(self.tick / 16000).position)
        for axis in range(2):
            aim = self.target[axis] + self.error[axis]
            self.position[axis] += max(-SPEED * SAMPLE, min(SPEED * SAMPLE, aim - self.position[axis]))
            row[f"axis{axis + 1}.position"] = self.position[axis]
            row[f"axis{axis + 1}.position_ref"] = self.target[axis]
            row[f"axis{axis + 1}.faults"] = float(self.faults)
            state, _, substate = self.state.split()[axis].partition("=")[2].partition("/")
            row[f"axis{axis + 1}.state"] = float(STATES[state])
            row[f"axis{axis + 1}.substate"] = float(SUBSTATES[substate] if substate else 0)
        self.rows.append(row)
        if self.twin_present:
            self._residuals.append((self.tick * 62_500, [self.twin_gap, -self.twin_gap]))

    def wait_for(self, condition: Callable[[], bool], timeout: float) -> bool:
        end = self.tick + round(timeout * 16000)
        while not condition():
            if self.tick >= end:
                return False
            self._step()
        return True

    def missing(self) -> list[str]:
        return []

    def enable(self, on: bool) -> None:
        self.log.append(f"enable {on}")
        self.state = "axis1=RUN/SPIN axis2=RUN/SPIN" if on else "axis1=STOP axis2=STOP"

    def quick_stop(self) -> None:
        self.log.append("quick_stop")
        self.target = list(self.position)
        self.applied.append(AppliedCommand("cmd.quick_stop", self.tick + 8, (1, 1), 3))

    def command(self, targets: Mapping[int, float]) -> None:
        if self.ignores_commands:
            return
        self.log.append(f"move {sorted(targets)}")
        if self.path is not None:
            self.path, self.lost_paths = None, self.lost_paths - 1
        for axis, value in targets.items():
            self.target[axis] = value
        self.applied.append(AppliedCommand("cmd.position", self.tick + 8, (0, 0), 3))

    def follow(self, path: Motion, start_ns: int) -> None:
        self.log.append(f"path {list(path.joints)}")
        if self.refusals:
            self.refusals -= 1
            return
        self.path = path.shifted(start_ns * 1e-9)
        self.applied.append(AppliedCommand("cmd.points", self.tick + 8, (0,) * 8, 3))

    def check(self) -> None:
        pass

    def latest(self, column: str) -> float:
        return self.rows[-1][column]

    def since(self, tick: int, columns: Sequence[str]) -> list[NDArray[np.float64]]:
        chosen = list(itertools.takewhile(lambda row: row["tick"] >= tick, reversed(self.rows)))[::-1]
        return [np.array([row[name] for row in chosen]) for name in columns]

    def stamp_ns(self, tick: int) -> int:
        return next(round(row["tick"]) for row in self.rows if row["tick"] >= tick) * 62_500

    def residuals(self, start_ns: int, end_ns: int) -> NDArray[np.float64]:
        return np.array([v for t, v in self._residuals if start_ns <= t <= end_ns]).reshape(-1, 2)

    def residual_after(self, stamp_ns: int) -> bool:
        return bool(self._residuals) and self._residuals[-1][0] >= stamp_ns

    def now_ns(self) -> int:
        return self.tick * 62_500


def run(client: FakeClient, output: list[str] | None = None) -> Demo:
    lines: list[str] = [] if output is None else output
    demo = Demo(client, 2 * COUNT, 3.0, lines.append)  # type: ignore[arg-type]
    demo.connect(1.0, require_twin=False)
    demo.enable()
    demo.run()
    demo.disable()
    return demo


def test_every_kind_of_move_is_made_and_measured() -> None:
    client, output = FakeClient(twin_gap=3 * COUNT), list[str]()
    demo = run(client, output)
    moves = [(row.move, row.axis) for row in demo.rows]
    both = ["simultaneous", "reversal", "stop", "return"]
    assert moves == [("point to point", "axis1"), ("point to point", "axis2")] + [
        (move, axis) for move in both for axis in ("axis1", "axis2")
    ]
    assert client.log == [
        "enable True", "move [0]", "move [1]", "move [0, 1]", "move [0, 1]", "move [0, 1]", "move [0, 1]",
        "quick_stop", "enable True", "move [0, 1]", "path ['axis1', 'axis2']", "enable False",
    ]  # fmt: skip
    assert passed(demo.rows, demo.paths, twin=demo.twin)
    (path,) = demo.paths
    assert path.figures.ticks_apart == 0
    assert path.figures.start == pytest.approx(0.5 - SAMPLE, abs=1e-4)  # after the tick at which the points took effect
    assert max(path.figures.error_max) < 1e-3
    assert path.residuals[1].max == pytest.approx(3 * COUNT)
    first = demo.rows[0]
    assert first.figures.commanded == pytest.approx(5 * TURN)
    assert first.figures.settling_time == pytest.approx(5 * TURN / SPEED, abs=2 * SAMPLE)
    assert first.residual is not None
    assert first.residual.rms == pytest.approx(3 * COUNT)
    stops = [row.figures for row in demo.rows if row.move == "stop"]
    assert 14.9 * TURN < stops[0].reached < 15.2 * TURN
    assert any("half way: reversing" in line for line in output)


def test_axis_that_stops_short_fails_with_all_other_results() -> None:
    client = FakeClient()
    client.error[1] = 3 * COUNT
    demo = run(client)
    assert not passed(demo.rows, demo.paths, twin=True)
    assert [row.figures.arrived for row in demo.rows if row.axis == "axis1"] == [True] * 5
    assert not any(row.figures.arrived for row in demo.rows if row.axis == "axis2" and row.move != "stop")


def test_a_path_that_the_board_refuses_is_sent_again() -> None:
    client, output = FakeClient(), list[str]()
    client.refusals = 2
    demo = run(client, output)
    assert passed(demo.rows, demo.paths, twin=demo.twin)
    assert sum("no cmd.points took effect" in line for line in output) == 2
    client = FakeClient()
    client.refusals = 3
    with pytest.raises(CommandError, match="not accepted in 3 attempts"):
        run(client)


def test_a_path_whose_points_are_late_is_repeated_more_slowly() -> None:
    client, output = FakeClient(), list[str]()
    client.lost_paths = 2
    demo = run(client, output)
    assert passed(demo.rows, demo.paths, twin=demo.twin)
    assert [path.figures.duration for path in demo.paths] == pytest.approx([16.0])
    assert sum("did not reach the board in time: the set-points of axis1 left" in line for line in output) == 2
    client = FakeClient()
    client.lost_paths = 3
    with pytest.raises(CommandError, match="did not follow"):
        run(client)


class WaitingClient(ServoClient):
    """Client without ROS: every turn of its executor takes a time and may bring a sample."""

    def __init__(self, turn: float, ticks: int | None) -> None:
        self._rows, self.columns = [], ["tick"]
        self._turn, self._ticks = turn, ticks
        self.turns = 0

    def step(self) -> None:
        self.turns += 1
        time.sleep(self._turn)
        if self._ticks is not None:
            self._rows.append(np.array([float(self.turns * self._ticks)]))


def test_waits_follow_the_board_time() -> None:
    client = WaitingClient(0.005, 160)  # 10 ms of the board in 5 ms, and more
    assert not client.wait_for(lambda: False, 0.2)
    assert client.turns == 21
    assert client.wait_for(lambda: client.turns == 30, 10.0)


def test_waits_without_telemetry_count_turns_of_the_program() -> None:
    client = WaitingClient(0.05, None)  # the computer stops the program for most of the time
    assert not client.wait_for(lambda: False, 0.1)
    assert client.turns == 5


def test_end_of_the_telemetry_ends_every_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_client, "_SILENCE", 0.1)
    client = WaitingClient(0.05, None)
    client._rows.append(np.zeros(1))
    with pytest.raises(CommandError, match=r"no telemetry for 0\.1 s: the bridge or its board was lost"):
        client.wait_for(lambda: False, 1e3)
    assert client.turns == 5


def test_connection_fails_without_progress_only() -> None:
    client = FakeClient()
    waits = iter(range(1, 100))
    left = [3]

    def missing() -> list[str]:
        return ["enable", "state", "snapshot"][: left[0]]

    def wait_for(condition: Callable[[], bool], timeout: float) -> bool:
        left[0] = max(3 - next(waits), 0)
        return condition()

    client.missing, client.wait_for = missing, wait_for  # type: ignore[method-assign]
    Demo(client, COUNT, 1.0, lambda _: None).connect(1.0, require_twin=False)  # type: ignore[arg-type]
    client.wait_for = lambda condition, timeout: condition()  # type: ignore[method-assign]
    left[0] = 2
    with pytest.raises(CommandError, match=r"no servo within 1 s; .*missing: enable, state\. "):
        Demo(client, COUNT, 1.0, lambda _: None).connect(1.0, require_twin=False)  # type: ignore[arg-type]


def test_missing_samples_of_the_twin_fail_but_no_twin_does_not() -> None:
    client = FakeClient()
    client.residuals = lambda start_ns, end_ns: np.empty((0, 2))  # type: ignore[method-assign]
    demo = run(client)
    assert demo.twin
    assert not passed(demo.rows, demo.paths, twin=demo.twin)
    client = FakeClient()
    client.twin_present = False
    demo = run(client)
    assert not demo.twin
    assert passed(demo.rows, demo.paths, twin=demo.twin)
    client = FakeClient()
    client.twin_present = False
    client._residuals.clear()
    with pytest.raises(CommandError, match="no residuals of a twin"):
        Demo(client, COUNT, 1.0, lambda _: None).connect(0.1, require_twin=True)  # type: ignore[arg-type]


def test_fault_ends_the_demonstration_with_cause_and_remedy() -> None:
    client = FakeClient()
    client.fault_at = 6000
    with pytest.raises(CommandError, match=r"axis1=FAULT.*UNDER_VOLTAGE: .*check the supply"):
        run(client)


def test_set_point_that_is_not_applied_is_reported() -> None:
    client = FakeClient()
    client.ignores_commands = True
    with pytest.raises(CommandError, match=r"no cmd\.position took effect"):
        run(client)


# ---- command line
@pytest.mark.realtime
def test_missing_servo_gives_a_message_and_status_2(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "servo_bridge.demo", "--wait", "0.5", "--json", str(tmp_path / "x.json")],
        capture_output=True,
        text=True,
        timeout=30,
        env=dict(os.environ, ROS_DOMAIN_ID=str(DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST"),
        check=False,
    )
    assert result.returncode == 2
    assert "Start the servo first" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "x.json").exists()


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_demonstration_disables_the_axes(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    with Rig() as rig:
        rig.connect(STOP, STOP)
        interrupts = iter([number])

        def before_sample() -> None:
            """The shafts of this board do not move, so the first move lasts until the interruption."""
            enables = [raw for name, _, raw in rig.link.written if name == "cmd.enable"]
            rig.link.set_states(*[SPIN if enables and any(enables[-1]) else STOP] * 2)
            if any(name == "cmd.position" for name, *_ in rig.link.written):
                for each in interrupts:
                    os.kill(os.getpid(), each)

        with rig.samples(before_sample):
            assert demo_module.main([]) == 128 + number
        assert rig.link.written[-1] == ("cmd.enable", 0, (0, 0))
    output = capfd.readouterr()
    assert "disabled: axis1=STOP axis2=STOP" in output.out
    assert "Traceback" not in output.err


@pytest.mark.parametrize("arguments", [["--tolerance", "0"], ["--timeout", "-1"], ["--colour"]])
def test_wrong_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        demo_module.main(arguments)
    assert caught.value.code == 2
    assert "usage: servo-demo" in capsys.readouterr().err
