"""How a program ends: the table of ``servo_bridge/doc/failures.md``, cell by cell over the whole chain.

The reaction of the shaft is the first word of a cell of the document. The programs move axis 1. Cells that other files
test are listed in `ELSEWHERE`.
"""

from __future__ import annotations

import ast
import math
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import pytest
from chain import FAST_BAUD, Chain, User, ros_user
from servo_msgs_py.answers import LEASE_TIMEOUT
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from std_srvs.srv import Trigger

ROOT: Final = Path(__file__).resolve().parents[1]
DOCUMENT: Final = ROOT / "servo_bridge" / "doc" / "failures.md"
SPEED: Final = 40.0
"""``param.speed_limit`` of the test [rad/s]."""
TARGET: Final = 120.0  # rad
COMMAND_TIMEOUT: Final = 0.5  # s
BUSY: Final = 0.5
"""Time that the processes of a loaded computer need for a reaction in addition to the documented one [s]."""
RESUMED: Final = 10.0  # longest time until a resumed program ends [s]

DEMO: Final = """
import sys
from servo_bridge.client import ros_session
from servo_bridge.demo_client import ServoClient
from servo_bridge.trajectory.shapes import lissajous
with ros_session(sys.argv) as session, ServoClient(session, "servo", "twin") as client:
    client.wait_for(lambda: not client.missing(), 20.0)
    path = lissajous(client.joints, [client.latest(f"axis{k}.position") for k in (1, 2)], [6.0] * 2, (0.5, 0.75), 8.0)
    client.follow(path, client.now_ns() + 500_000_000)
    client.wait_for(lambda: False, 60.0)
"""
"""The path of ``servo-demo``, without the moves before it."""

COMMANDS: Final[Mapping[str, tuple[str, ...]]] = {
    "servo-command move": ("move", f"axis1={TARGET}", "--time", "6"),
    "servo-command follow": ("follow", "path.csv"),
    "servo-command sine": ("sine", "axis1", "--amplitude", "6", "--frequency", "0.5", "--for", "6"),
    "servo-command velocity": ("velocity", "axis1=20", "--for", "3"),
    "servo-command position": ("position", f"axis1={TARGET}"),
    "servo-command home": ("home", "axis1", "--method", "stop-positive"),
    "servo-demo": (),
}
CELLS: Final = [
    ("servo-command follow", "signal"),
    *((program, "killed") for program in COMMANDS),
    ("servo-command sine", "suspended"),
    ("servo-command velocity", "suspended"),
    *((f"servo-command {verb}", "output closed") for verb in ("sine", "velocity", "home")),
    *((f"servo-command {verb}", "bridge killed") for verb in ("sine", "home")),
]
ELSEWHERE: Final[Mapping[tuple[str, str], tuple[str, str]]] = {
    **{
        (f"servo-command {verb}", "signal"): ("servo_bridge/test/test_command.py", "test_signal_stops_the_joints")
        for verb in ("move", "sine", "velocity", "effort", "position", "home")
    },
    ("servo-demo", "signal"): ("servo_bridge/test/test_demo.py", "test_an_interrupted_demonstration_disables_the_axes"),
    ("servo-tool identify", "signal"): (
        "tests/test_identify_on_board.py",
        "test_signal_keeps_the_recordings_and_restores_the_board",
    ),
    ("servo-tool bode", "signal"): (
        "tests/test_bode_on_board.py",
        "test_interruption_stops_the_shaft_and_restores_the_board",
    ),
    ("servo-tool record", "signal"): (
        "servo_bridge/test/test_tool_record.py",
        "test_signal_ends_a_burst_and_keeps_its_points",
    ),
    ("servo-tool identify", "killed"): (
        "tests/test_measurement_killed.py",
        "test_board_restores_itself_when_the_program_is_killed",
    ),
    **{
        (f"servo-tool {command}", "killed"): (
            "tests/test_measurement_killed.py",
            "test_board_restores_itself_when_the_program_is_killed",
        )
        for command in ("bode", "ripple", "resonance", "autotune")
    },
    ("servo-tool autotune", "signal"): (
        "tests/test_autotune_on_board.py",
        "test_ctrl_c_in_the_move_leaves_the_configuration_from_before",
    ),
    ("servo-tool bode", "output closed"): (
        "tests/test_bode_on_board.py",
        "test_a_closed_output_leaves_the_files_and_the_board",
    ),
    ("servo-tool record", "output closed"): (
        "servo_bridge/test/test_tool_record.py",
        "test_a_closed_output_leaves_the_file",
    ),
    ("servo-command effort", "killed"): ("tests/test_failures_board.py", "test_torque_not_renewed"),
    ("servo-demo", "bridge killed"): ("servo_bridge/test/test_demo.py", "test_end_of_the_telemetry_ends_every_wait"),
    ("servo-demo", "output closed"): (
        "servo_bridge/test/test_demo.py",
        "test_an_interrupted_demonstration_disables_the_axes",
    ),
    **{
        ("servo-tool commission", event): (
            "tests/test_commission_on_board.py",
            "test_an_end_in_the_move_stops_the_shaft_and_switches_off",
        )
        for event in ("signal", "killed")
    },
    ("servo-tool record", "killed"): (
        "servo_bridge/test/test_tool_record.py",
        "test_lost_line_ends_a_burst_with_the_reason",
    ),
}
"""Cells that other files test in simulated time: file and function."""

LIKE: Final[Mapping[tuple[str, str], tuple[str, str]]] = {
    **{
        (f"servo-command {verb}", "bridge killed"): ("servo-command sine", "bridge killed")
        for verb in ("move", "follow", "position", "velocity", "effort")
    },
    **{
        (f"servo-command {verb}", "output closed"): ("servo-command sine", "output closed")
        for verb in ("move", "follow", "position")
    },
    ("servo-command effort", "output closed"): ("servo-command velocity", "output closed"),
    ("servo-tool identify", "output closed"): ("servo-tool bode", "output closed"),
    ("servo-tool autotune", "output closed"): ("servo-tool bode", "output closed"),
    **{
        (f"servo-tool {command}", event): ("servo-tool bode", event)
        for command in ("ripple", "resonance")
        for event in ("signal", "output closed")
    },
}
"""Cells whose program does what that of a tested cell does.

It waits in the same loop of `Motions`, or reaches the board in the same way, and prints after its end only.
"""


def table() -> dict[tuple[str, str], str]:
    """Reaction, the first word of a cell of the document, by program and event; without empty cells."""
    text = DOCUMENT.read_text(encoding="utf-8").partition("| program |")[2]
    head, _, *rows = [line.strip("|").split("|") for line in ("|" + text.partition("\n\n")[0]).splitlines()]
    cells = {}
    for programs, *reactions in rows:
        first = programs.strip(" `").split()[0].rstrip("`")
        for program in re.findall(r"`([a-z-]+(?: [a-z]+)?)`", programs):
            name = program if program.startswith("servo-") else f"{first} {program}"
            for event, reaction in zip(head, reactions, strict=True):
                if reaction.strip():
                    cells[name, event.strip()] = reaction.split()[0].strip("`;,")
    return cells


TABLE: Final = table()


def column(event: str) -> str:
    return "killed" if event == "suspended" else event


def test_every_cell_has_a_test() -> None:
    """Each cell of the table, or one whose program does the same."""
    tested = {(program, column(event)) for program, event in (*CELLS, *ELSEWHERE)}
    assert tested | LIKE.keys() == TABLE.keys()
    assert set(LIKE.values()) <= tested
    assert all(TABLE[cell] == TABLE[other] for cell, other in LIKE.items())
    for path, function in ELSEWHERE.values():
        tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
        assert function in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}, path


class Rig:
    """Board and bridge, and one program that moves axis 1."""

    def __init__(self, chain: Chain, user: User) -> None:
        self.chain, self.user = chain, user
        chain.board()
        self._zero = [user.node.create_client(Trigger, f"/servo/axis{k}/home/here") for k in (1, 2)]
        self.start_bridge()
        times = "\n".join(f"{0.5 * k},{12.0 * k}" for k in range(1, 13))
        (chain.folder / "path.csv").write_text(f"time,axis1\n{times}\n")

    def start_bridge(self) -> None:
        """Start a bridge and wait until it is connected."""
        features = "ANTI_WINDUP+ENHANCED_MT+BUS_COMPENSATION+DEAD_TIME+HOMING"
        parameters = [f"param.speed_limit={SPEED},{SPEED}", f"param.features={features},{features}"]
        for messages in self.user.messages.values():
            messages.clear()
        self.bridge = self.chain.bridge(board_parameters=parameters)
        self.user.until(lambda: self.user.connected() and self.user.messages["/servo/snapshot"], 30.0)
        self.user.until(lambda: all(client.service_is_ready() for client in self._zero), 10.0)
        self.user.until(lambda: "axis1=" in self.user.last("/servo/state") and self.user.messages["/servo/armed"])

    def start(self, program: str) -> subprocess.Popen[str]:
        """Start a program and wait until axis 1 moves for it."""
        if not self.bridge.running:
            self.start_bridge()
        if "FAULT" in self.user.last("/servo/state"):
            assert self.user.clear_faults()[0]
        if self.user.last("/servo/armed") is not True:
            self.user.enable_axes()
        self.rest()
        for client in self._zero:  # an axis that is not homed is confined to some turns
            assert self.user.call(client, Trigger.Request())[0]
        command = [str(Path(sys.executable).with_name("servo-command")), *COMMANDS[program]]
        if program == "servo-demo":
            command = [sys.executable, "-c", DEMO]
        process = subprocess.Popen(
            with_parent_death_signal(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.chain.environment,
            cwd=self.chain.folder,
        )
        self.user.until(lambda: abs(self.speed) > 2.0 or process.poll() is not None, 20.0, f"{program}: no motion")
        assert process.poll() is None, process.communicate()
        return process

    @property
    def last(self) -> Mapping[str, float]:
        return self.user.rows(len(self.user.messages["/servo/snapshot"]) - 1)[-1]

    @property
    def speed(self) -> float:
        return self.last["axis1.speed"]

    @property
    def time(self) -> float:
        """Board time of the newest sample [s]."""
        return self.last["tick"] / 16_000.0

    def rest(self, within: float = 15.0) -> float:
        """Wait until axis 1 has rested for 0.2 s; returns the board time at which it stopped [s]."""
        stopped = math.inf

        def rests() -> bool:
            nonlocal stopped
            stopped = min(stopped, self.time) if abs(self.speed) < 0.5 else math.inf
            return self.time - stopped > 0.2

        self.user.until(rests, within, "axis 1 does not stop")
        return stopped

    def holds(self) -> bool:
        return "axis1=RUN/SPIN" in self.user.last("/servo/state")

    def status(self, process: subprocess.Popen[str]) -> int:
        self.user.until(lambda: process.poll() is not None, RESUMED, "the program does not end")
        process.communicate()
        return int(process.returncode)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    chain = Chain(tmp_path_factory.mktemp("ends"), FAST_BAUD, level="ideal")
    with ros_user() as user:
        try:
            yield Rig(chain, user)
        finally:
            chain.end()
            print(chain.logs())


def end(rig: Rig, process: subprocess.Popen[str], event: str) -> None:
    """Let an event happen to a program."""
    if event == "output closed":
        assert process.stdout is not None
        process.stdout.close()
    elif event == "bridge killed":
        rig.bridge.kill()
    else:
        numbers = {"signal": signal.SIGHUP, "killed": signal.SIGKILL, "suspended": signal.SIGSTOP}
        process.send_signal(numbers[event])


@pytest.mark.realtime
@pytest.mark.parametrize(("program", "event"), CELLS)
def test_shaft_reacts_as_the_table_says(rig: Rig, program: str, event: str) -> None:
    reaction = TABLE[program, column(event)]
    process = rig.start(program)
    try:
        begin = rig.time
        end(rig, process, event)
        if event == "bridge killed":
            assert rig.status(process) == 1
            return
        if reaction == "continues":
            rig.user.wait_board_time(1.0)
            assert abs(rig.speed) > 0.5
        else:
            stopped = rig.rest() - begin
            limits = {
                "stops": BUSY,
                "lapses": LEASE_TIMEOUT + BUSY,
                "velocity-not-renewed": COMMAND_TIMEOUT + BUSY,
                "completes": 12.0,
            }
            assert stopped < limits[reaction]
            if reaction == "completes":
                assert rig.last["axis1.position"] == pytest.approx(TARGET, abs=0.05)
        assert rig.holds()
        if event == "signal":
            assert rig.status(process) == 128 + signal.SIGHUP
        elif event == "output closed" and program != "servo-command home":  # it would search for long
            assert rig.status(process) == 128 + signal.SIGPIPE
        elif event == "suspended":
            rig.user.until(lambda: rig.time > begin + LEASE_TIMEOUT + BUSY)
            process.send_signal(signal.SIGCONT)
            assert rig.status(process) == 1
    finally:
        process.kill()
        process.wait()
        if rig.bridge.running and abs(rig.speed) > 0.5:
            rig.user.quick_stop()
