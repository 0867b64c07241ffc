"""The lifecycle of the bridge, by the services of ``ros2 lifecycle``, with a fake link."""

from __future__ import annotations

from typing import Any

import pytest
from bridge_rig import SPIN, STOP, Rig
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from servo_bridge.supervisor import Supervisor
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = "unconfigured", "inactive", "active", "finalized"
ACTIVATE_FIRST = "the bridge is inactive; activate it first (ros2 lifecycle set /servo/servo_bridge activate)"


def call(rig: Rig, kind: Any, service: str, request: Any) -> Any:
    client = rig.user.create_client(kind, f"servo_bridge/{service}")
    rig.until(client.service_is_ready)
    future = client.call_async(request)
    rig.until(future.done)
    rig.user.destroy_client(client)
    return future.result()


def state(rig: Rig) -> str:
    return str(call(rig, GetState, "get_state", GetState.Request()).current_state.label)


def change(rig: Rig, transition: str, identifier: int = 0) -> tuple[bool, str]:
    """Request a transition by label or number; return its success and the state after it."""
    request = ChangeState.Request(transition=Transition(id=identifier, label=transition))
    return bool(call(rig, ChangeState, "change_state", request).success), state(rig)


def endpoints(rig: Rig) -> tuple[list[str], ...]:
    """Names of all topics and services of the node, with duplicates."""
    node = rig.bridge
    return (
        sorted(each.topic_name for each in node.publishers),
        sorted(each.topic_name for each in node.subscriptions),
        sorted(each.srv_name for each in node.services),
        sorted(str(each.timer_period_ns) for each in node.timers),
    )


def rejected(rig: Rig) -> str:
    """Reason of the refusal of a set-point."""
    before = len(rig.rejections())
    rig.commands.publish(Float64MultiArray(data=[1.0, 1.0]))
    rig.until_rejected(before)
    return rig.rejections()[-1]


def test_every_transition_from_unconfigured_to_finalized() -> None:
    with Rig(autostart=False) as rig:
        assert state(rig) == UNCONFIGURED
        assert rig.links == []
        assert rig.user.count_publishers(topics.STATE) == 0
        assert not rig.enable_client.service_is_ready()

        assert change(rig, "", Transition.TRANSITION_CONFIGURE) == (True, INACTIVE)
        rig.discover()
        rig.connect(SPIN, SPIN)
        assert rig.diagnosis("commands").message == ACTIVATE_FIRST
        assert rig.enable(True) == (False, f"{ACTIVATE_FIRST}; then call enable again")
        assert f"commands: {ACTIVATE_FIRST}; then call the service enable" in rejected(rig)
        assert rig.clear_faults()[0], "services without motion are available"

        rig.link.written.clear()
        assert change(rig, "activate") == (True, ACTIVE)
        assert "the outputs have not been enabled by this bridge" in rejected(rig)
        assert rig.link.written == []
        assert not rig.armed()
        assert rig.enable(True)[0]
        rig.until(rig.armed)

        assert change(rig, "deactivate") == (True, INACTIVE)
        assert change(rig, "cleanup") == (True, UNCONFIGURED)
        rig.until(lambda: not rig.enable_client.service_is_ready())
        assert change(rig, "shutdown") == (True, FINALIZED)
        assert rig.bridge.finished


def test_deactivate_stops_the_axes_and_telemetry_goes_on() -> None:
    with Rig() as rig:
        rig.enable_axes()
        rig.commands.publish(Float64MultiArray(data=[1.0, 2.0]))
        rig.until(lambda: ("cmd.position", 0) in {write[:2] for write in writes(rig)})
        rig.link.written.clear()
        assert change(rig, "deactivate") == (True, INACTIVE)
        rig.until(lambda: ("cmd.quick_stop", 0, (1, 1)) in writes(rig))
        rig.until(lambda: not rig.armed())
        assert ACTIVATE_FIRST in rejected(rig)
        seen = len(rig.messages[topics.JOINT_STATES])
        rig.link.sample()
        rig.until(lambda: len(rig.messages[topics.JOINT_STATES]) > seen)

        rig.link.written.clear()
        assert change(rig, "activate") == (True, ACTIVE)
        assert "stopped because the bridge was deactivated; call the service enable" in rejected(rig)
        assert not writes(rig)
        assert not rig.armed()


def writes(rig: Rig) -> list[Any]:
    """Writes after one more sample."""
    rig.link.sample()
    return rig.link.written


@pytest.mark.parametrize("asked", ["deactivate", "cleanup"])
def test_deactivate_cancels_a_pending_enable(asked: str) -> None:
    with Rig() as rig:
        rig.connect(STOP, STOP)
        enable = rig.enable_client.call_async(SetBool.Request(data=True))
        rig.until(lambda: ("cmd.enable", 0, (1, 1)) in writes(rig))
        if asked == "cleanup":
            assert change(rig, "deactivate")[0]
        assert change(rig, asked)[0]

        def answered() -> bool:
            rig.link.sample()
            return bool(enable.done())

        rig.until(answered)
        assert not enable.result().success
        assert not rig.armed()


def test_invalid_transitions_are_refused() -> None:
    with Rig(autostart=False) as rig:
        for label, identifier in (("activate", 0), ("", Transition.TRANSITION_DEACTIVATE), ("fly", 0), ("", 200)):
            assert change(rig, label, identifier) == (False, UNCONFIGURED)
        rig.until(lambda: len(rig.logs()) >= 4)
        assert rig.logs() == [
            f"no transition {asked} from state unconfigured; possible: configure, shutdown"
            for asked in ("activate", Transition.TRANSITION_DEACTIVATE, "fly", 200)
        ]
        assert change(rig, "configure")[0]
        assert change(rig, "configure") == (False, INACTIVE)
        assert change(rig, "activate")[0]
        assert change(rig, "cleanup") == (False, ACTIVE)
        assert len(rig.links) == 1


def test_cleanup_releases_everything_and_permits_other_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    with Rig() as rig:
        configured = endpoints(rig)
        rig.enable_axes()
        taken, reason = rig.set_parameter("port", "/dev/other")
        assert not taken
        assert reason == (
            "parameter port can be changed only while the node is unconfigured: ros2 lifecycle set /servo/servo_bridge "
            "deactivate, then cleanup"
        )
        assert rig.set_parameter("port", "/dev/ttyUSB0")[0], "already in that state"
        first, supervisor = rig.link, rig.bridge.supervisor
        assert supervisor is not None
        assert change(rig, "deactivate")[0]
        close = first.close

        def close_under_load(*arguments: Any) -> bool:
            for _ in range(20):
                rig.commands.publish(Float64MultiArray(data=[1.0, 1.0]))
            return close(*arguments)

        monkeypatch.setattr(first, "close", close_under_load)
        assert change(rig, "cleanup") == (True, UNCONFIGURED)
        assert [(name, list(values)) for name, values in first.final_writes] == [("cmd.enable", [0.0, 0.0])]
        rig.until(lambda: rig.user.count_publishers(topics.JOINT_STATES) == 0)
        first.sample()  # pending operations end without effect
        supervisor._every_second()
        supervisor.parts.variables.publish()
        supervisor._watch.sign_of_life()
        for name, value in (("port", "/dev/other"), ("baud", 9600), ("joints", ["pan", "axis2"])):
            assert rig.set_parameter(name, value)[0]
        assert not rig.set_parameter("autostart", False)[0]

        assert change(rig, "configure")[0]
        assert change(rig, "activate")[0]
        assert rig.link is not first
        assert (rig.link.config.url, rig.link.config.baud) == ("/dev/other", 9600)
        renamed = tuple([name.replace("axis1", "pan") for name in names] for names in configured)
        assert tuple(map(sorted, renamed)) == endpoints(rig)
        rig.until(lambda: rig.user.count_publishers(topics.JOINT_STATES) == 1)
        rig.until(lambda: rig.user.count_subscribers("axis1/position") == 0)
        rig.until(lambda: rig.enable_client.service_is_ready())
        rig.until(lambda: rig.state() == "DISCONNECTED connecting to a test")
        rig.connect()
        assert rig.state() == "pan=STOP axis2=STOP"


def test_invalid_parameters_are_refused_until_all_are_corrected() -> None:
    wrong = {"joints": ["one"], "velocity_max": [-1.0, 1.0]}
    with Rig(autostart=False, **wrong) as rig:
        assert change(rig, "configure") == (False, UNCONFIGURED)
        rig.until(rig.logs)
        assert "not configured: parameter joints is ['one']" in rig.logs()[-1]
        assert rig.set_parameter("joints", ["a", "b"])[0]
        assert change(rig, "configure") == (False, UNCONFIGURED)
        rig.until(lambda: len(rig.logs()) > 1)
        assert "parameter velocity_max" in rig.logs()[-1]
        assert rig.set_parameter("velocity_max", [1.0, 1.0])[0]
        assert not rig.set_parameter("velocity_max", [1.0])[0], "all parameters are valid now"
        assert change(rig, "configure") == (True, INACTIVE)
        assert len(rig.links) == 1


def test_a_lost_link_does_not_change_the_state_of_the_lifecycle() -> None:
    with Rig() as rig:
        rig.enable_axes()
        rig.link.disconnect(reason="pulled")
        rig.until(lambda: not rig.armed())
        assert state(rig) == ACTIVE
        assert change(rig, "deactivate") == (True, INACTIVE)
        rig.until(lambda: rig.warnings("quick stop failed: not connected: pulled"))
        rig.connect(SPIN, SPIN)
        assert not rig.enable(True)[0]
        assert change(rig, "activate") == (True, ACTIVE)
        assert not rig.armed()
        assert rig.enable(True)[0]


@pytest.mark.parametrize(("transition", "method"), [("activate", "activate"), ("cleanup", "close")])
def test_exception_is_reported_and_leaves_the_node_unconfigured(
    transition: str, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Rig() as rig:
        rig.connect(SPIN, SPIN)
        assert change(rig, "deactivate")[0]
        link, works = rig.link, getattr(Supervisor, method)

        def fails(*arguments: Any) -> None:
            if method == "close":
                works(*arguments)
            raise ZeroDivisionError("of the test")

        monkeypatch.setattr(Supervisor, method, fails)
        assert change(rig, transition) == (False, UNCONFIGURED)
        monkeypatch.undo()
        rig.until(lambda: any("ZeroDivisionError: of the test" in text for text in rig.logs(40)))
        assert link.final_writes
        rig.until(lambda: not rig.enable_client.service_is_ready())
        assert change(rig, "configure")[0]
        assert change(rig, "activate") == (True, ACTIVE)
        rig.discover()
        rig.enable_axes()


def test_autostart_does_not_hide_an_exception(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: Supervisor) -> None:
        raise ZeroDivisionError("of the test")

    monkeypatch.setattr(Supervisor, "activate", fails)
    with pytest.raises(ZeroDivisionError, match="of the test"):
        Rig()
