"""Motion services without ROS: order of stop and enable, answers, checks of faults."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from board_context_rig import board_context
from servo_bridge.arbiter import Arbiter
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.motion_services import MotionServices
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.set_points import Mode, NotReady, SetPointRequest
from servo_bridge.telemetry import AxisStatus, Snapshot
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint, joint_names

CATALOGUE = Catalogue.load()
JOINTS = joint_names(DEFAULT_JOINTS)
SPINNING = AxisStatus("RUN/SPIN", accepts_set_points=True)
STOPPED = AxisStatus("STOP", accepts_set_points=False)


class Rig:
    """Services with a real arbiter and dispatcher; `sample` models the board."""

    def __init__(self, joints: Sequence[Joint] = DEFAULT_JOINTS) -> None:
        self.sent: list[CommandWrite] = []
        self.arbiter = Arbiter(CATALOGUE, joints)
        self.dispatcher = Dispatcher(self.sent.append, self.arbiter.queue, lambda _: None)
        self.events: list[str] = []
        self.services = MotionServices(board_context(log=self.events.append), JOINTS, self.arbiter, self.dispatcher)
        self.values: dict[str, float] = {}
        self.tick = 0
        self.count = 0

    def sample(self, *axes: AxisStatus, faults: tuple[int, int] = (0, 0), applied: bool = False) -> None:
        self.tick += 16
        self.count += applied
        axes = axes or (SPINNING, SPINNING)
        snapshot = Snapshot(self.tick, 0, 0, self.values, self.tick, self.count, axes, faults)
        for part in (self.arbiter, self.dispatcher, self.services):
            part.on_sample(snapshot)

    def connected(self, *axes: AxisStatus) -> Rig:
        self.dispatcher.open()
        self.sample(*(axes or (STOPPED, STOPPED)))
        return self

    def done(self, **state: tuple[int, int]) -> None:
        """Apply the last write and deliver a sample with its effect."""
        self.dispatcher.acknowledged(self.sent[-1], None)
        self.sample(applied=True, **state)


def test_enable_accepts_set_points_after_its_effect() -> None:
    rig = Rig().connected()
    answer = rig.services.enable(True)
    rig.dispatcher.acknowledged(rig.sent[-1], None)
    assert not answer.done()
    assert not rig.arbiter.armed
    rig.sample(applied=True)
    assert answer.result(0) == (True, "both axes are enabled; set-points are accepted")
    assert rig.arbiter.armed


def test_enable_answers_when_set_points_are_accepted() -> None:
    rig = Rig().connected()
    answer = rig.services.enable(True)
    rig.dispatcher.acknowledged(rig.sent[-1], None)
    rig.sample(STOPPED, STOPPED, applied=True)
    for _ in range(1000):
        rig.sample(SPINNING, AxisStatus("RUN/STARTUP", accepts_set_points=False))
    assert not answer.done()
    rig.sample()
    assert answer.result(0) == (True, "both axes are enabled; set-points are accepted")


@pytest.mark.parametrize("used", range(AXES))
def test_an_axis_without_a_motor_is_left_off_and_keeps_no_other_from_moving(used: int) -> None:
    rig = Rig([Joint(axis_name(axis), used=axis == used) for axis in range(AXES)])
    dead = AxisStatus("FAULT", accepts_set_points=False, faulted=True)
    faults = (0, 1) if used == 0 else (1, 0)
    states = (SPINNING, dead) if used == 0 else (dead, SPINNING)
    rig.connected(*((STOPPED, dead) if used == 0 else (dead, STOPPED)))
    answer = rig.services.enable(True)
    assert rig.sent[-1] == CommandWrite("cmd.enable", used, (1,))
    rig.dispatcher.acknowledged(rig.sent[-1], None)
    rig.sample(*states, faults=faults, applied=True)
    assert answer.result(0) == (True, f"{axis_name(used)} is enabled; set-points are accepted")
    assert rig.arbiter.armed
    rig.arbiter.submit(SetPointRequest("commands", Mode.POSITION, {used: 1.0}))
    with pytest.raises(NotReady, match=f"parameter used says that {axis_name(1 - used)} has no motor"):
        rig.arbiter.submit(SetPointRequest("commands", Mode.POSITION, {1 - used: 1.0}))


def test_enable_times_out() -> None:
    rig = Rig().connected()
    answer = rig.services.enable(True)
    rig.dispatcher.acknowledged(rig.sent[-1], None)
    rig.sample(STOPPED, STOPPED, applied=True)
    rig.tick += 40_000
    rig.sample(SPINNING, STOPPED)
    success, text = answer.result(0)
    assert success
    assert "enabling in progress: axis1 is in RUN/SPIN, axis2 is in STOP; set-points are accepted when armed is" in text


def test_enable_reports_inputs_that_prevent_it() -> None:
    rig = Rig().connected()
    current, inputs = (CATALOGUE.flag("limits", name) for name in ("CURRENT", "INPUT"))
    rig.values = {"axis1.limits": float(current.mask), "axis2.limits": float(inputs.mask)}
    answer = rig.services.enable(True)
    rig.dispatcher.acknowledged(rig.sent[-1], None)
    rig.sample(STOPPED, STOPPED, applied=True)
    rig.tick += 40_000
    rig.sample(SPINNING, STOPPED)
    success, text = answer.result(0)
    assert not success
    assert text.startswith(f"axis2: INPUT: {inputs.cause}")
    assert "CURRENT" not in text


@pytest.mark.parametrize("end", ["fault", "stop", "link"])
def test_enable_answers_at_once_if_it_is_impossible(end: str) -> None:
    rig = Rig().connected()
    answer = rig.services.enable(True)
    rig.dispatcher.acknowledged(rig.sent[-1], None)
    rig.sample(STOPPED, STOPPED, applied=True)
    assert not answer.done()
    if end == "fault":
        rig.sample(AxisStatus("FAULT", accepts_set_points=False, faulted=True), STOPPED, faults=(1, 0))
    elif end == "stop":
        rig.services.quick_stop()
        rig.sample(STOPPED, STOPPED)
    else:
        rig.services.lost("gone")
    success, text = answer.result(0)
    assert not success
    assert {"fault": "then call clear_faults", "stop": "interrupted by a stop", "link": "gone"}[end] in text


@pytest.mark.parametrize("stop", ["disable", "quick_stop"])
def test_later_stop_prevents_set_points(stop: str) -> None:
    rig = Rig().connected()
    enable = rig.services.enable(True)
    halt = rig.services.quick_stop() if stop == "quick_stop" else rig.services.enable(False)
    rig.done()
    success, text = enable.result(0)
    assert not success
    assert "call enable again" in text
    assert not rig.arbiter.armed
    rig.done()
    assert halt.result(0)[0]
    assert [w.variable for w in rig.sent] == ["cmd.enable", "cmd.quick_stop" if stop == "quick_stop" else "cmd.enable"]
    assert not rig.arbiter.armed


def test_stop_refuses_set_points_at_once() -> None:
    rig = Rig().connected()
    rig.services.enable(True)
    rig.done()
    assert rig.arbiter.armed
    rig.services.quick_stop()
    assert not rig.arbiter.armed


def test_refusal_of_the_write_is_the_answer() -> None:
    rig = Rig().connected()
    answer = rig.services.enable(True)
    rig.dispatcher.acknowledged(rig.sent[-1], "the board answers 89, access denied")
    assert answer.result(0) == (False, "the board answers 89, access denied")
    assert not rig.arbiter.armed


def test_clear_faults_checks_the_faults_after_its_effect() -> None:
    rig = Rig().connected()
    answer = rig.services.clear_faults()
    rig.done(faults=(0, 0))
    assert not answer.done()
    rig.sample(faults=(0, 2))
    assert not answer.done()
    rig.sample(faults=(0, 2))
    success, text = answer.result(0)
    assert not success
    assert text.startswith("not cleared, the cause persists: axis2: UNDER_VOLTAGE")
    assert not rig.arbiter.armed


def test_a_lost_link_answers_every_caller() -> None:
    rig = Rig().connected()
    enable, clear = rig.services.enable(True), rig.services.clear_faults()
    rig.done()
    rig.dispatcher.acknowledged(rig.sent[-1], None)
    rig.dispatcher.lost("pulled")
    rig.services.lost("pulled")
    assert enable.result(0)[0]
    assert clear.result(0) == (False, "pulled")
    for answer in (rig.services.enable(True), rig.services.enable(False), rig.services.clear_faults()):
        assert "not connected: pulled" in answer.result(0)[1]


def test_link_loss_answers_a_pending_fault_check() -> None:
    rig = Rig().connected()
    answer = rig.services.clear_faults()
    rig.done()
    rig.services.lost("pulled")
    assert answer.result(0) == (False, "the link was lost: pulled")


def test_enable_in_fault_needs_no_write() -> None:
    rig = Rig().connected()
    rig.sample(STOPPED, AxisStatus("FAULT", accepts_set_points=False, faulted=True), faults=(0, 1))
    success, text = rig.services.enable(True).result(0)
    assert not success
    assert text.startswith("axis2: OVER_VOLTAGE")
    assert rig.sent == []


@pytest.mark.parametrize("axes", [(SPINNING, STOPPED), (SPINNING, SPINNING)])
def test_axes_that_spin_when_the_link_comes_up_are_reported_once(axes: tuple[AxisStatus, AxisStatus]) -> None:
    """The link stops them before it identifies the board."""
    rig = Rig().connected(*axes)
    rig.sample(*axes)
    assert rig.events == ["the board was enabled at the connection and has been stopped; call enable to continue"]
    rig.dispatcher.lost("pulled")
    rig.services.lost("pulled")
    rig.connected(*axes)
    assert len(rig.events) == 2
    assert rig.sent == []


def test_axes_at_rest_are_not_stopped_at_the_connection() -> None:
    rig = Rig().connected(STOPPED, AxisStatus("RUN/ALIGN", accepts_set_points=False))
    rig.sample()
    assert rig.sent == []
