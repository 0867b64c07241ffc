"""A client of ``follow_joint_trajectory`` in a process of its own: runs every case once and prints what came back.

The environment of ``interface_build`` has to be set when it starts. Each case is a line of JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from chain import User, user
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

BOTH = ("axis1", "axis2")
ACTION = "/servo/follow_joint_trajectory"
TIMEOUT = 20.0
STATUS = {
    GoalStatus.STATUS_SUCCEEDED: "SUCCEEDED",
    GoalStatus.STATUS_ABORTED: "ABORTED",
    GoalStatus.STATUS_CANCELED: "CANCELED",
}


def duration(seconds: float) -> Duration:
    return Duration(sec=int(seconds), nanosec=round(seconds % 1.0 * 1e9))


def goal(joints: Sequence[str], *points: tuple[float, Sequence[float]], stamp: float = 0.0, **fields: Any) -> Any:
    """A goal whose points are times [s] and positions [rad]."""
    trajectory = JointTrajectory(
        joint_names=list(joints),
        points=[JointTrajectoryPoint(positions=list(p), time_from_start=duration(t)) for t, p in points],
    )
    trajectory.header.stamp.sec, trajectory.header.stamp.nanosec = int(stamp), round(stamp % 1.0 * 1e9)
    return FollowJointTrajectory.Goal(trajectory=trajectory, **fields)


class Running:
    """A goal that has been accepted."""

    def __init__(self, client: Client, wanted: Any) -> None:
        self._client = client
        self.feedback: list[Any] = []
        sent = client.action.send_goal_async(wanted, lambda message: self.feedback.append(message.feedback))
        client.me.until(sent.done, TIMEOUT, "the goal is not answered")
        self.handle = sent.result()
        assert self.handle.accepted
        self._result = self.handle.get_result_async()

    def moving(self) -> Running:
        """Wait until it says that a joint moves."""
        self._client.me.until(
            lambda: any(max(map(abs, f.actual.velocities)) > 0.5 for f in self.feedback), TIMEOUT, "nothing moves"
        )
        return self

    def result(self) -> dict[str, Any]:
        self._client.me.until(self._result.done, TIMEOUT, "no result")
        response = self._result.result()
        return {
            "status": STATUS[response.status],
            "code": response.result.error_code,
            "text": response.result.error_string,
            "feedback": len(self.feedback),
            "at": [self._client.me.position_of(axis) for axis in (0, 1)],
        }


class Client:
    """The action client of a user of the servo."""

    def __init__(self, me: User) -> None:
        self.me = me
        self.action = ActionClient(me.node, FollowJointTrajectory, ACTION)
        me.until(self.action.server_is_ready, 30.0, "no action server")

    def here(self) -> list[float]:
        return [self.me.position_of(axis) for axis in (0, 1)]

    def go(self, *points: tuple[float, float], joints: Sequence[str] = BOTH, **fields: Any) -> Running:
        """Goal of the same way for every joint: times [s] and distances from here [rad]."""
        at = dict(zip(BOTH, self.here(), strict=True))
        rows = [(t, [at[joint] + way for joint in joints]) for t, way in points]
        return Running(self, goal(joints, *rows, **fields))

    def rest(self) -> None:
        """Wait until both shafts hold."""
        quiet = time.monotonic() + 0.3

        def holds() -> bool:
            nonlocal quiet
            if max(map(abs, self.me.messages["/servo/joint_states"][-1].velocity)) > 1.0:
                quiet = time.monotonic() + 0.3
            return time.monotonic() > quiet

        self.me.until(holds, TIMEOUT, "the shafts do not rest")


# ---- cases: each returns what the test looks at
def succeeds(client: Client) -> dict[str, Any]:
    before = client.here()
    running = client.go((0.5, 1.5), (1.0, 3.0))
    result = running.result()
    last = running.feedback[-1]
    columns = zip(last.desired.positions, last.actual.positions, last.error.positions, strict=True)
    return result | {
        "ways": [b - a for a, b in zip(before, result["at"], strict=True)],
        "joints": list(last.joint_names),
        "errors": [desired - actual - error for desired, actual, error in columns],
    }


def one_joint(client: Client) -> dict[str, Any]:
    before = client.here()
    result = client.go((0.5, 1.0), joints=["axis2"]).result()
    return result | {"ways": [b - a for a, b in zip(before, result["at"], strict=True)]}


def cancelled(client: Client) -> dict[str, Any]:
    before = client.here()
    running = client.go((6.0, 30.0)).moving()
    running.handle.cancel_goal_async()
    result = running.result()
    client.rest()
    return result | {"ways": [b - a for a, b in zip(before, client.here(), strict=True)]}


def preempted(client: Client) -> dict[str, Any]:
    """A second goal of one joint: the other joint of the first one stops."""
    before = client.here()
    first = client.go((6.0, 30.0)).moving()
    second = client.go((0.5, 1.0), joints=["axis1"])
    result = first.result() | {"second": second.result()["status"]}
    client.rest()
    return result | {"ways": [b - a for a, b in zip(before, client.here(), strict=True)]}


def path_tolerance(client: Client) -> dict[str, Any]:
    wanted = [JointTolerance(name="axis1", position=1e-5)]
    result = client.go((6.0, 30.0), path_tolerance=wanted).result()
    before = client.here()
    client.rest()
    return result | {"ways": [b - a for a, b in zip(before, client.here(), strict=True)]}


def goal_tolerance(client: Client) -> dict[str, Any]:
    wanted = [JointTolerance(name="axis1", position=1e-9)]
    return client.go((0.5, 1.0), goal_tolerance=wanted, goal_time_tolerance=duration(0.2)).result()


def unknown_joint(client: Client) -> dict[str, Any]:
    return Running(client, goal(["elbow"], (1.0, [0.0]))).result()


def old_stamp(client: Client) -> dict[str, Any]:
    stamp = client.me.node.get_clock().now().nanoseconds * 1e-9 - 60.0
    return client.go((1.0, 1.0), stamp=stamp).result()


def future_stamp(client: Client) -> dict[str, Any]:
    begin = client.me.node.get_clock().now().nanoseconds * 1e-9
    result = client.go((0.5, 1.0), stamp=begin + 1.0).result()
    return result | {"lasted": client.me.node.get_clock().now().nanoseconds * 1e-9 - begin}


def withdrawn(client: Client) -> dict[str, Any]:
    """A goal for later is cancelled while another one of the same joints runs."""
    running = client.go((1.5, 1.0)).moving()
    later = client.go((1.0, 1.0), stamp=client.me.node.get_clock().now().nanoseconds * 1e-9 + 60.0)
    later.handle.cancel_goal_async()
    return later.result() | {"first": running.result()["status"]}


def too_fast(client: Client) -> dict[str, Any]:
    return client.go((0.1, 300.0)).result()


def empty(client: Client) -> dict[str, Any]:
    first = client.go((6.0, 30.0)).moving()
    result = Running(client, goal(BOTH)).result()
    return result | {"first": first.result()["status"]}


def set_point(client: Client) -> dict[str, Any]:
    """A set-point takes one joint over: the goal is given up, and the other joint stops."""
    before = client.here()
    running = client.go((6.0, 30.0)).moving()
    client.me.joint_commands.publish(JointState(name=["axis1"], position=[before[0]]))
    result = running.result()
    client.rest()
    return result | {"ways": [b - a for a, b in zip(before, client.here(), strict=True)]}


def disabled(client: Client) -> dict[str, Any]:
    running = client.go((6.0, 30.0)).moving()
    client.me.enable(False)
    return running.result()


CASES: Sequence[Callable[[Client], dict[str, Any]]] = (
    succeeds, one_joint, cancelled, preempted, path_tolerance, goal_tolerance, unknown_joint, old_stamp, future_stamp,
    withdrawn, too_fast, empty, set_point, disabled,
)  # fmt: skip


def main() -> int:
    with user() as me:
        me.until(me.connected, 30.0, "the bridge is not connected")
        me.spinning()
        client = Client(me)
        for case in CASES:
            client.rest()
            print(json.dumps({"case": case.__name__, **case(client)}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
