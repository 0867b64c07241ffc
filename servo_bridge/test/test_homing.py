"""Homing without ROS: answers, directions, and the restored position after a restart of the board."""

from __future__ import annotations

from concurrent.futures import Future

import pytest
from board_context_rig import board_context
from servo_bridge.arbiter import Arbiter
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.homing import Homing
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.telemetry import AxisStatus, Snapshot
from servo_msgs_py.catalogue import Catalogue, Value
from servo_msgs_py.joints import Joint

from servo_msgs_py import topics

CATALOGUE = Catalogue.load()
STATE, METHOD, RESULT = (CATALOGUE.enums[f"home_{name}_t"] for name in ("state", "method", "result"))
FEATURE = CATALOGUE.flag("features", "HOMING").mask
LSB = CATALOGUE["cmd.home_position"].lsb


class Rig:
    """Homing with a real arbiter and dispatcher; `sample` models the board."""

    def __init__(self, *, restores: bool = True, features: int = FEATURE) -> None:
        self.sent: list[CommandWrite] = []
        self.log: list[str] = []
        self.moved: list[int] = []
        self.values = {f"axis{k}.home_{what}": 0.0 for k in (1, 2) for what in ("result", "spread")}
        joints = (Joint("arm", gear_ratio=10.0, direction=-1, offset=0.5), Joint("hand"))
        self.arbiter = Arbiter(CATALOGUE, joints)
        self.dispatcher = Dispatcher(self._send, self.arbiter.queue, self.log.append)
        self.homing = Homing(
            board_context(self._read, log=self.log.append),
            joints,
            [1.5, 0.0],
            restores,
            self.arbiter,
            self.dispatcher,
            lambda: [features, features],
            self.moved.append,
        )
        self.states = [0, 0]
        self.counts = [0, 0]
        self.speed = 0.0
        self.label = "RUN/SPIN"
        self.tick = self.applied = self.epoch = 0
        self.dispatcher.open()
        self.sample()

    def _send(self, write: CommandWrite) -> None:
        self.sent.append(write)

    def _read(self, name: str) -> Future[Value]:
        done: Future[Value] = Future()
        states = {f"axis{k}.home_state": float(state) for k, state in enumerate(self.states, 1)}
        done.set_result((states | self.values)[name])
        return done

    def sample(self, ticks: int = 16) -> None:
        """Apply the last write, and deliver a sample."""
        self.tick += ticks
        if self.sent and self.sent[-1].variable != "seen":
            write = self.sent[-1]
            self.dispatcher.acknowledged(write, None)
            self.applied += 1
        spins = self.label == "RUN/SPIN"
        axes = tuple(AxisStatus(self.label, spins, position=counts) for counts in self.counts)
        speeds = {f"axis{k}.speed": self.speed for k in (1, 2)}
        snapshot = Snapshot(self.tick, self.epoch, 0, speeds, self.tick, self.applied, axes, (0, 0))
        snapshot = self.homing.completed(snapshot)
        for part in (self.arbiter, self.dispatcher, self.homing):
            part.on_sample(snapshot)

    def read_states(self) -> None:
        """Run until the bridge has read the homing states."""
        self.sample(4000)
        self.sample()

    def written(self) -> list[tuple[str, int, tuple[int, ...]]]:
        return [(write.variable, write.first, write.raw) for write in self.sent]

    def restart(self) -> None:
        """Restart the board, with all counts at 0."""
        self.epoch += 1
        self.tick, self.states, self.counts, self.label = 0, [0, 0], [0, 0], "STOP"
        self.sample()


def test_methods_are_those_of_the_board() -> None:
    assert {name.upper() for name in topics.HOME_METHODS} == METHOD.keys() - {"NONE", "ASSUME"}


@pytest.mark.parametrize(
    ("result", "success", "text"),
    [("DONE", True, "spread of the reference 3 counts"), ("NOT_FOUND", False, "turns_max")],
)
def test_homing_answers_at_its_end(result: str, success: bool, text: str) -> None:
    rig = Rig()
    rig.arbiter.release()
    answer = rig.homing.home(1, "stop_negative")
    rig.sample()
    rig.states[1] = STATE["HOMING"]
    for _ in range(50):
        rig.sample()
    assert not answer.done()
    assert rig.written() == [("cmd.home_position", 1, (0,)), ("cmd.home", 1, (METHOD["STOP_NEGATIVE"],))]
    rig.values |= {"axis2.home_result": RESULT[result], "axis2.home_spread": 3}
    rig.states[1] = STATE["KNOWN"]
    rig.read_states()
    assert answer.result(0)[0] is success
    assert text in answer.result(0)[1]
    assert rig.homing.known == [False, True]


def test_directions_and_positions_are_those_of_the_joint() -> None:
    rig = Rig()
    rig.arbiter.release()
    rig.homing.home(0, "switch_positive")
    rig.sample()
    value = round((1.5 - 0.5) * -10.0 / LSB)
    assert rig.written() == [("cmd.home_position", 0, (value,)), ("cmd.home", 0, (METHOD["SWITCH_NEGATIVE"],))]


def test_a_homing_motion_needs_an_enabled_axis() -> None:
    rig = Rig()
    answer = rig.homing.home(1, "stop_positive")
    assert not answer.result(0)[0]
    assert "enable" in answer.result(0)[1]
    assert not rig.sent
    rig.homing.home(1, "here")
    assert rig.sent, "a method without motion"


def test_link_loss_answers_a_pending_homing() -> None:
    rig = Rig()
    rig.arbiter.release()
    answer = rig.homing.home(1, "stop_negative")
    rig.sample()
    rig.sample()
    rig.homing.lost("unplugged")
    assert answer.result(0) == (False, "the link was lost: unplugged")
    assert rig.homing.known == [False, False]


def known(rig: Rig) -> None:
    rig.states, rig.counts = [STATE["KNOWN"]] * 2, [12_345, -77]
    rig.read_states()


def test_positions_are_restored_after_a_restart() -> None:
    rig = Rig()
    known(rig)
    rig.restart()
    waits = rig.homing.restoring
    assert waits, "positions have another zero until the restoration"
    for _ in range(6):
        rig.sample()
    assert rig.written() == [
        ("cmd.home_position", 0, (12_345,)),
        ("cmd.home_position", 1, (-77,)),
        ("cmd.home", 0, (METHOD["ASSUME"],)),
        ("cmd.home", 1, (METHOD["ASSUME"],)),
    ]
    rig.states, rig.counts = [STATE["ASSUMED"]] * 2, [12_345, -77]
    rig.read_states()
    assert not rig.homing.restoring
    assert rig.homing.known == [False, False], "the shaft may have moved during the restart"
    rig.restart()
    rig.sample()
    assert len(rig.sent) > 4, "an assumed position is restored too"


def test_counts_since_the_restart_are_kept() -> None:
    """The shaft is turned manually before the position is restored."""
    rig = Rig()
    known(rig)
    rig.restart()
    rig.counts = [40, 0]
    for _ in range(6):
        rig.sample()
    values = [raw for name, axis, (raw,) in rig.written() if name == "cmd.home_position" and axis == 0]
    assert values[0] == 12_345
    rig.sample(3_200)
    rig.sample()
    values = [raw for name, axis, (raw,) in rig.written() if name == "cmd.home_position" and axis == 0]
    assert values[-1] == 12_345 + 40


def test_a_second_call_ends_the_first() -> None:
    rig = Rig()
    first = rig.homing.home(0, "here")
    for _ in range(3):
        rig.sample()
    second = rig.homing.home(0, "here")
    assert first.result() == (False, "arm is not homed: ended by another command, a stop or a fault")
    assert not second.done()


@pytest.mark.parametrize("how", ["not wanted", "feature off", "unknown before", "lost before", "turned before"])
def test_position_is_not_restored_if_it_is_unknown_or_may_have_changed(how: str) -> None:
    rig = Rig(restores=how != "not wanted", features=0 if how == "feature off" else FEATURE)
    if how != "unknown before":
        known(rig)
    if how == "lost before":
        rig.states = [0, 0]
        rig.read_states()
    if how == "turned before":
        rig.speed = 10.0
        rig.sample()
        rig.speed = 0.0
    rig.restart()
    for _ in range(10):
        rig.sample()
    assert not rig.sent
    assert not rig.homing.restoring


def test_restoration_without_effect_is_repeated_a_limited_number_of_times() -> None:
    rig = Rig()
    known(rig)
    rig.restart()
    for _ in range(24):
        rig.sample(1600)
    assert len(rig.sent) > 8
    assert not rig.homing.restoring
    assert any("home it" in text for text in rig.log)


def test_position_of_a_spinning_axis_is_not_restored() -> None:
    rig = Rig()
    known(rig)
    rig.restart()
    rig.sent.clear()
    rig.label = "RUN/SPIN"
    rig.sample()
    assert not rig.homing.restoring
