"""Goals of an action whose trajectory is a serialised message.

rclpy converts every goal before a callback sees it: with 100 000 points it takes seconds, no keep-alive is sent, and
the board stops its axes. Here rclpy converts the goal without its points; the trajectory is serialised by the
middleware without the lock of the interpreter, and read where the path is planned.
"""

from __future__ import annotations

import ctypes
from typing import Any, Final

from rclpy.type_support import check_for_type_support
from trajectory_msgs.msg import JointTrajectory

_LIBRARY: Final = "librcl.so"  # loads the libraries of all functions used here
_GOAL_ID: Final = 16  # bytes of a request before its goal, which begins with the trajectory


class _Sequence(ctypes.Structure):
    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))


class _Trajectory(ctypes.Structure):
    """``trajectory_msgs__msg__JointTrajectory``."""

    _fields_ = (
        ("stamp", ctypes.c_uint32 * 2),
        ("frame_id", _Sequence),
        ("joint_names", _Sequence),
        ("points", _Sequence),
    )


class _Allocator(ctypes.Structure):
    """``rcutils_allocator_t``."""

    _fields_ = (("functions", ctypes.c_void_p * 5),)


class _Bytes(ctypes.Structure):
    """``rmw_serialized_message_t``."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


_Conversion = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
_capsule = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)(
    ("PyCapsule_New", ctypes.pythonapi)
)
_pointer = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)


def with_raw_trajectories(action: Any, trajectories: dict[bytes, bytes]) -> Any:
    """Type of an action for its server, whose goals have no points.

    Parameters
    ----------
    action : type
        FollowJointTrajectory.
    trajectories : dict
        Receives the serialised trajectory of each goal, by the bytes of its id. Without the functions of rcl that this
        needs, `action` is returned, and nothing is received.
    """
    try:
        rcl = ctypes.CDLL(_LIBRARY)
        serialize, free, allocator = rcl.rmw_serialize, rcl.rcutils_uint8_array_fini, rcl.rcutils_get_default_allocator
    except (OSError, AttributeError):
        return action
    for kind in (action, JointTrajectory):
        check_for_type_support(kind)
    serialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(_Bytes)]
    free.argtypes = [ctypes.POINTER(_Bytes)]
    allocator.restype = _Allocator
    service = action.Impl.SendGoalService
    request = type(service.Request)
    support = _pointer(type(JointTrajectory)._TYPE_SUPPORT, None)
    convert = _Conversion(_pointer(request._CONVERT_TO_PY, None))

    def converted(message: int) -> Any:
        """Request without points; rclpy calls it with the request of the middleware."""
        trajectory, data = _Trajectory.from_address(message + _GOAL_ID), _Bytes(allocator=allocator())
        try:
            if serialize(ctypes.byref(trajectory), support, data):
                return convert(message)
            size, trajectory.points.size = trajectory.points.size, 0
            try:
                goal = convert(message)
            finally:
                trajectory.points.size = size
            trajectories[bytes(goal.goal_id.uuid)] = ctypes.string_at(data.buffer, data.length)
            return goal
        finally:
            free(data)

    class RawRequest:
        """What rclpy needs of a class of messages."""

        conversion = _Conversion(converted)
        _CREATE_ROS_MESSAGE = request._CREATE_ROS_MESSAGE
        _DESTROY_ROS_MESSAGE = request._DESTROY_ROS_MESSAGE
        _CONVERT_TO_PY = _capsule(ctypes.cast(conversion, ctypes.c_void_p), None, None)

    class SendGoal(service):  # type: ignore[misc, valid-type]
        Request = RawRequest()

    class Impl(action.Impl):
        SendGoalService = SendGoal

    raw: Any = type(action)("RawAction", (action,), {"Impl": Impl})
    return raw
