"""Alignment of one axis of the twin with the same axis of the real board: position offset and commands."""

from __future__ import annotations

from typing import Final, NamedTuple

from servo_msgs_py.board_port import reached
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import AppliedCommand

from servo_twin.lockstep.replica import POLL, Replica
from servo_twin.lockstep.samples import ROTOR_REFERENCED, Activity, Sample, activity

POINTS: Final = "cmd.points"
_SET_POINTS: Final = ("cmd.position", "cmd.speed", "cmd.i_q", "cmd.points")  # by control mode
_STOPS: Final = (("cmd.quick_stop", 1), ("cmd.enable", 0))
_ENABLE: Final = ("cmd.enable", 1)
_POSITIONS: Final = ("cmd.position", "cmd.home_position")  # commands with absolute positions
_HOME: Final = "cmd.home"


class ShaftPosition(NamedTuple):
    """Where a real shaft is."""

    theta: float  # position of the firmware [rad of the motor]
    referenced: bool  # counted from the home position, else from where the rotor was found


class AxisAlignment:
    """Alignment of one axis.

    Parameters
    ----------
    number : int
        Index of the axis.
    catalogue : Catalogue
        For ``home_method_t`` and ``home_state_t``.
    """

    def __init__(self, number: int, catalogue: Catalogue) -> None:
        self.last_written: dict[str, int] = {}  # last raw value of every command variable, if known
        self.different_since: int | None = None  # real tick of the first difference of the states; None: comparable
        self.stopping = False
        """After a stop command or an expired set-point, until the next set-point: each board ramps down from its own
        measured speed, so the final positions differ."""
        self.number = number
        self._name = axis_name(number)
        self._positions = [f"{self._name}.{name}" for name in ROTOR_REFERENCED]
        self._expired = False  # set-point expired on either board at the last sample
        self._faulted = False  # the real axis is in FAULT and ignores an enable
        self._release()
        self._offset = 0
        methods, states = (catalogue.enums[name] for name in ("home_method_t", "home_state_t"))
        self._set_here = (methods["HERE"], methods["ASSUME"])
        self._settings = {states["KNOWN"]: methods["HERE"], states["ASSUMED"]: methods["ASSUME"]}
        self._homing = states["HOMING"]
        self._referenced = (states["KNOWN"], states["ASSUMED"])

    @property
    def offset(self) -> int:
        """Position of the real axis minus that of the twin [counts], modulo 2^32."""
        return self._offset

    def _release(self) -> None:
        """Reset the alignment: the real axis is not in closed-loop control."""
        self._hold: int | None = None  # set-point of the real axis at the start of closed-loop control [counts]
        self._aligned = False  # the offset has been determined since the start of closed-loop control
        self._caught_up = False  # the twin has been run ahead for this axis
        self._set_point_deferred = False  # a set-point was received before the alignment

    # ---- start
    def _begin(self) -> None:
        self.different_since = None
        self.stopping = self._expired = self._faulted = False
        self._offset = 0
        self._release()

    def begin_from_reset(self) -> None:
        """Start the alignment of two boards that were reset at the same tick."""
        self._begin()
        self.last_written.update({"cmd.mode": 0, "cmd.quick_stop": 0})

    def begin_at(self, sample: Sample, replica: Replica) -> bool:
        """Start the alignment at a sample, with the twin's board in STOP.

        Returns
        -------
        bool
            True if the real axis is in closed-loop control, so that the twin's axis must be enabled.
        """
        self._begin()
        self._offset = _int32(sample.position[self.number] - replica.raw[f"{self._name}.position"])
        if activity(sample.labels[self.number]) is not Activity.ACTIVE:
            return False
        self._hold = sample.position_ref[self.number]
        return True

    def set_home_state(self, replica: Replica, sample: Sample) -> None:
        """Set the home state of the twin to that of the board; both shafts must be at standstill."""
        method = self._settings.get(sample.home_states[self.number])
        if method is not None:
            own = replica.raw[f"{self._name}.position"]
            replica.write("cmd.home_position", [own] * AXES, 1 << self.number)
            replica.write(_HOME, [method] * AXES, 1 << self.number)

    def homed(self, before: Sample | None, sample: Sample) -> bool:
        """True if the homing of the real axis has ended at this sample; the twin's position is then invalid."""
        was = before is not None and before.home_states[self.number] == self._homing
        return was and sample.home_states[self.number] != self._homing

    def shaft(self, sample: Sample) -> ShaftPosition:
        """Where the real shaft is."""
        return ShaftPosition(
            sample.values[f"{self._name}.position"], sample.home_states[self.number] in self._referenced
        )

    # ---- commands
    def remember(self, command: AppliedCommand) -> None:
        """Store a command of the real axis in `last_written`."""
        if command.mask >> self.number & 1 and command.variable != POINTS:
            self.last_written[command.variable] = command.raw[self.number]
            if command.variable == "cmd.enable" and command.raw[self.number] == 1:
                self.last_written["cmd.quick_stop"] = 0  # as in the firmware

    def repeat(self, replica: Replica, command: AppliedCommand) -> bool:
        """Repeat a command on the twin if it concerns this axis.

        Returns
        -------
        bool
            True if the command contains points for this axis; the caller writes the points of all axes together.
        """
        if not command.mask >> self.number & 1:
            return False
        if command.variable in _SET_POINTS:
            if self._hold is not None and not self._aligned:
                self._set_point_deferred |= command.variable != POINTS  # timed points are obsolete after the alignment
                self.remember(command)
                return False
            if "cmd.mode" not in self.last_written:
                # cmd.mode is unknown: derive it from the kind of set-point.
                self.last_written["cmd.mode"] = _SET_POINTS.index(command.variable)
                self._write(replica, "cmd.mode", self.last_written["cmd.mode"])
        if command.variable == POINTS:
            self.stopping = False
            return True
        if command.variable == _HOME and command.raw[self.number] not in self._set_here:
            return False  # the twin has no model of the stops and switches of the real axis
        assignment = command.variable, command.raw[self.number]
        if assignment == ("cmd.clear_faults", 1):
            self._faulted = False
        if not (self._faulted and assignment == _ENABLE):
            self._write(replica, command.variable, command.raw[self.number])
        self.remember(command)
        if command.variable in _SET_POINTS:
            self.stopping = False
        elif assignment in _STOPS:
            self.stopping = True
        return False

    def _write(self, replica: Replica, variable: str, raw: int) -> None:
        own = _int32(raw - self._offset) if variable in _POSITIONS else raw
        replica.write(variable, [own] * AXES, 1 << self.number)

    def observe(self, replica: Replica, sample: Sample) -> None:
        """Update the states "set-point expired" and "in FAULT" of the boards."""
        expired = sample.expired[self.number] or replica.expired(self.number)
        self.stopping = self.stopping or (expired and not self._expired)
        self._expired = expired
        self._faulted = sample.labels[self.number] == "FAULT"

    # ---- alignment
    def must_catch_up(self, replica: Replica, sample: Sample) -> bool:
        """True if the real axis is in closed-loop control, the twin is not, and `catch_up` has not been called."""
        if activity(sample.labels[self.number]) is not Activity.ACTIVE:
            self._release()
            return False
        if self._hold is None:
            self._hold = sample.position_ref[self.number]
        return not (self._aligned or self._caught_up or self.in_control(replica))

    def catch_up(self, replica: Replica, seconds: float) -> None:
        """Run the twin's board ahead until closed-loop control or a fault of this axis, at most `seconds` [s]."""
        self._caught_up = True
        reached(replica, lambda: self.in_control(replica) or replica.label(self.number) == "FAULT", seconds, POLL)

    def in_control(self, replica: Replica) -> bool:
        """True if the twin's axis is in closed-loop control."""
        return activity(replica.label(self.number)) is Activity.ACTIVE

    def align(self, replica: Replica) -> bool:
        """Determine the offset when both axes have entered closed-loop control, before any set-point.

        Returns
        -------
        bool
            True if the offset has been determined; then call `restore`.
        """
        if self._hold is None or self._aligned or not self.in_control(replica):
            return False
        self._offset = _int32(self._hold - replica.raw[f"{self._name}.position_ref"])
        self._aligned = True
        return True

    def restore(self, replica: Replica) -> None:
        """Write the last commands of the real axis to the newly aligned axis."""
        mode = self.last_written.get("cmd.mode", 0)
        # Writing the mode again would end the position hold.
        variables = ["cmd.mode"] if replica.read_words("cmd.mode")[self.number] != mode else []
        if self._set_point_deferred:
            variables.append(_SET_POINTS[mode])
            self._set_point_deferred = False
        if self.last_written.get("cmd.quick_stop", 0):
            variables.append("cmd.quick_stop")
            self.stopping = True
        for variable in variables:
            if variable in self.last_written:
                self._write(replica, variable, self.last_written[variable])

    def align_at_standstill(self, replica: Replica, sample: Sample) -> bool:
        """Determine the offset again after a stop, with both shafts at standstill.

        Returns
        -------
        bool
            True if the offset has changed.
        """
        real, twin = activity(sample.labels[self.number]), activity(replica.label(self.number))
        if real is not twin or not (real is Activity.IDLE or self._aligned):
            return False
        self.stopping = False
        if real is Activity.ACTIVE:
            offset = sample.position_ref[self.number] - replica.raw[f"{self._name}.position_ref"]
        else:
            offset = sample.position[self.number] - replica.raw[f"{self._name}.position"]
        offset = _int32(offset)
        changed, self._offset = offset != self._offset, offset
        return changed

    # ---- comparison
    def difference(self, replica: Replica, sample: Sample) -> tuple[str, bool]:
        """Reason why the axes are not comparable (empty: comparable), and whether it is a rotor search or homing."""
        real, twin = sample.labels[self.number], replica.label(self.number)
        if sample.home_states[self.number] == self._homing:
            self.different_since = sample.tick
            return f"{self._name} is being homed", True
        kinds = {activity(real), activity(twin)}
        twin_fault_only = twin == "FAULT" != real  # the twin would ignore an enable of the real axis
        if (kinds == {Activity.IDLE} and not twin_fault_only) or (kinds == {Activity.ACTIVE} and self._aligned):
            self.different_since = None
            return "", False
        if self.different_since is None:
            self.different_since = sample.tick
        return f"{self._name} is {real}, its twin {twin}", Activity.SEARCHING in kinds

    def in_real_coordinates(self, replica: Replica, sample: Sample) -> dict[str, int]:
        """Positions of the twin's axis in the unwrapped coordinates of the real axis [counts], by variable name."""
        near, raw = sample.position[self.number], replica.raw
        return {name: near + _int32(raw[name] + self._offset - near) for name in self._positions}


def _int32(value: int) -> int:
    return (value + 0x8000_0000) % (1 << 32) - 0x8000_0000
