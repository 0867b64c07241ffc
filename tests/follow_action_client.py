"""Client of ``follow_joint_trajectory`` as a separate process: runs every case once and prints the result.

It needs the environment of ``interface_build``. The output is one line of JSON per case.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from chain import User, ros_user
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
    """Goal with points of (time [s], positions [rad])."""
    trajectory = JointTrajectory(
        joint_names=list(joints),
        points=[JointTrajectoryPoint(positions=list(p), time_from_start=duration(t)) for t, p in points],
    )
    trajectory.header.stamp.sec, trajectory.header.stamp.nanosec = int(stamp), round(stamp % 1.0 * 1e9)
    return FollowJointTrajectory.Goal(trajectory=trajectory, **fields)


class AcceptedGoal:
    """A goal that has been accepted."""

    def __init__(self, client: Client, request: Any) -> None:
        self._client = client
        self.feedback: list[Any] = []
        sent = client.action.send_goal_async(request, lambda message: self.feedback.append(message.feedback))
        client.user.until(sent.done, TIMEOUT, "the goal is not answered")
        self.handle = sent.result()
        assert self.handle.accepted
        self._result = self.handle.get_result_async()

    def wait_until_moving(self) -> AcceptedGoal:
        """Wait until the feedback contains a moving joint."""

        def moves() -> bool:
            assert not self._result.done(), f"the goal ended before a joint moved: {self.result()}"
            return any(max(map(abs, f.actual.velocities)) > 0.5 for f in self.feedback)

        self._client.user.until(moves, TIMEOUT, "no joint moves")
        return self

    def result(self) -> dict[str, Any]:
        self._client.user.until(self._result.done, TIMEOUT, "no result")
        response = self._result.result()
        return {
            "status": STATUS[response.status],
            "code": response.result.error_code,
            "text": response.result.error_string,
            "feedback": len(self.feedback),
            "at": [self._client.user.position_of(axis) for axis in (0, 1)],
        }


class Client:
    """Action client of a ROS node."""

    def __init__(self, user: User) -> None:
        self.user = user
        self.action = ActionClient(user.node, FollowJointTrajectory, ACTION)
        user.until(self.action.server_is_ready, 30.0, "no action server")

    def positions(self) -> list[float]:
        return [self.user.position_of(axis) for axis in (0, 1)]

    def send_goal(self, *points: tuple[float, float], joints: Sequence[str] = BOTH, **fields: Any) -> AcceptedGoal:
        """Send a goal of equal distances for every joint: times [s] and distances from the present position [rad]."""
        at = dict(zip(BOTH, self.positions(), strict=True))
        rows = [(t, [at[joint] + distance for joint in joints]) for t, distance in points]
        return AcceptedGoal(self, goal(joints, *rows, **fields))

    def wait_for_standstill(self) -> None:
        """Wait until both shafts have been at rest for 0.3 s."""
        settled = time.monotonic() + 0.3

        def is_at_rest() -> bool:
            nonlocal settled
            if max(map(abs, self.user.messages["/servo/joint_states"][-1].velocity)) > 1.0:
                settled = time.monotonic() + 0.3
            return time.monotonic() > settled

        self.user.until(is_at_rest, TIMEOUT, "the shafts are not at rest")


# ---- cases: each returns the values that the test checks
def succeeds(client: Client) -> dict[str, Any]:
    before = client.positions()
    running = client.send_goal((0.5, 1.5), (1.0, 3.0))
    result = running.result()
    last = running.feedback[-1]
    columns = zip(last.desired.positions, last.actual.positions, last.error.positions, strict=True)
    return result | {
        "distances": [b - a for a, b in zip(before, result["at"], strict=True)],
        "joints": list(last.joint_names),
        "errors": [desired - actual - error for desired, actual, error in columns],
    }


def one_joint(client: Client) -> dict[str, Any]:
    before = client.positions()
    result = client.send_goal((0.5, 1.0), joints=["axis2"]).result()
    return result | {"distances": [b - a for a, b in zip(before, result["at"], strict=True)]}


def cancelled(client: Client) -> dict[str, Any]:
    before = client.positions()
    running = client.send_goal((6.0, 30.0)).wait_until_moving()
    running.handle.cancel_goal_async()
    result = running.result()
    client.wait_for_standstill()
    return result | {"distances": [b - a for a, b in zip(before, client.positions(), strict=True)]}


def longest(client: Client) -> dict[str, Any]:
    """As many waypoints as a trajectory may have: the axes stay enabled while the goal is read."""
    running = client.send_goal(*((0.5 + 1e-3 * k, 1e-3 * k) for k in range(100_000))).wait_until_moving()
    running.handle.cancel_goal_async()
    return running.result()


def preempted(client: Client) -> dict[str, Any]:
    """A second goal for one joint: the other joint of the first goal stops."""
    before = client.positions()
    first = client.send_goal((6.0, 30.0)).wait_until_moving()
    second = client.send_goal((0.5, 1.0), joints=["axis1"])
    result = first.result() | {"second": second.result()["status"]}
    client.wait_for_standstill()
    return result | {"distances": [b - a for a, b in zip(before, client.positions(), strict=True)]}


def path_tolerance(client: Client) -> dict[str, Any]:
    tolerance = [JointTolerance(name="axis1", position=1e-5)]
    result = client.send_goal((6.0, 30.0), path_tolerance=tolerance).result()
    before = client.positions()
    client.wait_for_standstill()
    return result | {"distances": [b - a for a, b in zip(before, client.positions(), strict=True)]}


def goal_tolerance(client: Client) -> dict[str, Any]:
    tolerance = [JointTolerance(name="axis1", position=1e-9)]
    return client.send_goal((0.5, 1.0), goal_tolerance=tolerance, goal_time_tolerance=duration(0.2)).result()


def unknown_joint(client: Client) -> dict[str, Any]:
    return AcceptedGoal(client, goal(["elbow"], (1.0, [0.0]))).result()


def old_stamp(client: Client) -> dict[str, Any]:
    stamp = client.user.node.get_clock().now().nanoseconds * 1e-9 - 60.0
    return client.send_goal((1.0, 1.0), stamp=stamp).result()


def future_stamp(client: Client) -> dict[str, Any]:
    begin = client.user.node.get_clock().now().nanoseconds * 1e-9
    result = client.send_goal((0.5, 1.0), stamp=begin + 1.0).result()
    return result | {"lasted": client.user.node.get_clock().now().nanoseconds * 1e-9 - begin}


def withdrawn(client: Client) -> dict[str, Any]:
    """A goal with a future start is cancelled while another goal of the same joints is active."""
    running = client.send_goal((1.5, 1.0)).wait_until_moving()
    later = client.send_goal((1.0, 1.0), stamp=client.user.node.get_clock().now().nanoseconds * 1e-9 + 60.0)
    later.handle.cancel_goal_async()
    return later.result() | {"first": running.result()["status"]}


def too_fast(client: Client) -> dict[str, Any]:
    return client.send_goal((0.1, 300.0)).result()


def empty(client: Client) -> dict[str, Any]:
    first = client.send_goal((6.0, 30.0)).wait_until_moving()
    result = AcceptedGoal(client, goal(BOTH)).result()
    return result | {"first": first.result()["status"]}


def set_point(client: Client) -> dict[str, Any]:
    """A set-point of one joint aborts the goal, and the other joint stops."""
    before = client.positions()
    running = client.send_goal((6.0, 30.0)).wait_until_moving()
    client.user.joint_commands.publish(JointState(name=["axis1"], position=[before[0]]))
    result = running.result()
    client.wait_for_standstill()
    return result | {"distances": [b - a for a, b in zip(before, client.positions(), strict=True)]}


def disabled(client: Client) -> dict[str, Any]:
    running = client.send_goal((6.0, 30.0)).wait_until_moving()
    client.user.enable(False)
    return running.result()


CASES: Sequence[Callable[[Client], dict[str, Any]]] = (
    succeeds, longest, one_joint, cancelled, preempted, path_tolerance, goal_tolerance, unknown_joint, old_stamp,
    future_stamp, withdrawn, too_fast, empty, set_point, disabled,
)  # fmt: skip


def main() -> int:
    with ros_user() as user:
        user.until(user.connected, 30.0, "the bridge is not connected")
        user.enable_axes()
        client = Client(user)
        for case in CASES:
            client.wait_for_standstill()
            print(json.dumps({"case": case.__name__, **case(client)}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
