"""How one axis of the twin is tied to the same axis of the real board: offset, set-points, agreement. Pure."""

from __future__ import annotations

from typing import Final

from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import AppliedCommand

from servo_twin.lockstep.replica import Replica
from servo_twin.lockstep.samples import COUNTED_FROM_ZERO, Activity, Sample, activity

POINTS: Final = "cmd.points"
_SET_POINTS: Final = ("cmd.position", "cmd.speed", "cmd.i_q", "cmd.points")  # by control mode
_STOPS: Final = (("cmd.quick_stop", 1), ("cmd.enable", 0))
_ENABLE: Final = ("cmd.enable", 1)
_POSITIONS: Final = ("cmd.position", "cmd.home_position")  # commands that are positions of a shaft
_HOME: Final = "cmd.home"


class AxisTie:
    """One axis.

    Parameters
    ----------
    number : int
        Index of the axis.
    catalogue : Catalogue
        For the names of what a position is worth.
    """

    def __init__(self, number: int, catalogue: Catalogue) -> None:
        self.memory: dict[str, int] = {}  # last raw number written to every command variable, as far as it is known
        self.apart_since: int | None = None  # real tick since which the two cannot be compared; None: they can
        self.stopping = False
        """A stop was commanded or a set-point has expired, and no set-point has followed: each board ramps down from
        the speed that it measures, so they come to rest at different places without either being wrong."""
        self._number = number
        self._name = axis_name(number)
        self._expired = False  # on either board, at the last sample
        self._faulted = False  # the real axis takes no enable
        self._release()
        self._offset = 0
        methods, states = (catalogue.enums[name] for name in ("home_method_t", "home_state_t"))
        self._set_here = (methods["HERE"], methods["ASSUME"])
        self._settings = {states["KNOWN"]: methods["HERE"], states["ASSUMED"]: methods["ASSUME"]}
        self._homing = states["HOMING"]

    @property
    def offset(self) -> int:
        """Position of the real axis minus that of the twin's [counts], modulo 2^32 as both counters wrap."""
        return self._offset

    def _release(self) -> None:
        """The real axis is not under control."""
        self._hold: int | None = None  # where the real axis held when it came under control [counts]
        self._aligned = False  # the offset is that of this time under control
        self._chased = False  # the twin has been run ahead for this axis
        self._withheld = False  # a set-point came before the axis was aligned

    # ---- beginning
    def begin(self, sample: Sample | None = None, replica: Replica | None = None) -> bool:
        """Tie anew: in the middle with a sample and a board in STOP, or without from the reset of both boards.

        Returns
        -------
        bool
            Whether the real axis is under control, so that the twin's has to be enabled.
        """
        self.apart_since = None
        self.stopping = self._expired = self._faulted = False
        self._offset = 0
        self._release()
        if sample is None or replica is None:
            self.memory.update({"cmd.mode": 0, "cmd.quick_stop": 0})
            return False
        self._offset = _int32(sample.position[self._number] - replica.raw[f"{self._name}.position"])
        if activity(sample.labels[self._number]) is not Activity.ACTIVE:
            return False
        self._hold = sample.position_ref[self._number]
        return True

    def take_over_home(self, replica: Replica, sample: Sample) -> None:
        """Have the twin's position be worth what the real one is; the shaft of neither may turn."""
        method = self._settings.get(sample.home_states[self._number])
        if method is not None:
            own = replica.raw[f"{self._name}.position"]
            replica.write("cmd.home_position", [own] * AXES, 1 << self._number)
            replica.write(_HOME, [method] * AXES, 1 << self._number)

    def homed(self, before: Sample | None, sample: Sample) -> bool:
        """Whether the real axis has looked for its reference up to this sample: it is elsewhere than the twin's now."""
        was = before is not None and before.home_states[self._number] == self._homing
        return was and sample.home_states[self._number] != self._homing

    # ---- commands
    def remember(self, command: AppliedCommand) -> None:
        """Note what was written to the real axis."""
        if command.mask >> self._number & 1 and command.variable != POINTS:
            self.memory[command.variable] = command.raw[self._number]
            if command.variable == "cmd.enable" and command.raw[self._number] == 1:
                self.memory["cmd.quick_stop"] = 0  # as in the firmware

    def repeat(self, replica: Replica, command: AppliedCommand) -> bool:
        """Write to the twin's axis what was written to the real one, as far as the command means it.

        Returns
        -------
        bool
            Whether the command holds points for this axis, which the caller has to write: those of all axes at once.
        """
        if not command.mask >> self._number & 1:
            return False
        if command.variable in _SET_POINTS:
            if self._hold is not None and not self._aligned:
                self._withheld |= command.variable != POINTS  # their time is over when the axis is aligned
                self.remember(command)
                return False
            if "cmd.mode" not in self.memory:
                # Never told, so the set-point that the board obeys has to tell.
                self.memory["cmd.mode"] = _SET_POINTS.index(command.variable)
                self._write(replica, "cmd.mode", self.memory["cmd.mode"])
        if command.variable == POINTS:
            self.stopping = False
            return True
        if command.variable == _HOME and command.raw[self._number] not in self._set_here:
            return False  # stops and switches of the real axis are not the twin's
        wanted = command.variable, command.raw[self._number]
        if wanted == ("cmd.clear_faults", 1):
            self._faulted = False
        if not (self._faulted and wanted == _ENABLE):
            self._write(replica, command.variable, command.raw[self._number])
        self.remember(command)
        if command.variable in _SET_POINTS:
            self.stopping = False
        elif wanted in _STOPS:
            self.stopping = True
        return False

    def _write(self, replica: Replica, variable: str, raw: int) -> None:
        own = _int32(raw - self._offset) if variable in _POSITIONS else raw
        replica.write(variable, [own] * AXES, 1 << self._number)

    def observe(self, replica: Replica, sample: Sample) -> None:
        """Note what the boards say of themselves: a set-point that has just expired, a fault that ignores an enable."""
        expired = sample.expired[self._number] or replica.expired(self._number)
        self.stopping = self.stopping or (expired and not self._expired)
        self._expired = expired
        self._faulted = sample.labels[self._number] == "FAULT"

    # ---- aligning
    def wants_to_catch_up(self, replica: Replica, sample: Sample) -> bool:
        """Whether the real axis has come under control and the twin's has not; says so once each time."""
        if activity(sample.labels[self._number]) is not Activity.ACTIVE:
            self._release()
            return False
        if self._hold is None:
            self._hold = sample.position_ref[self._number]
        return not (self._aligned or self._chased or self.controls(replica))

    def catch_up(self, replica: Replica, maximum: int) -> None:
        """Run the twin's board ahead until this axis is under control or has failed, at most `maximum` ticks."""
        self._chased = True
        replica.run_until(lambda: self.controls(replica) or replica.label(self._number) == "FAULT", maximum)

    def controls(self, replica: Replica) -> bool:
        """Whether the twin's axis is under control."""
        return activity(replica.label(self._number)) is Activity.ACTIVE

    def align(self, replica: Replica) -> bool:
        """Choose the offset, once both axes have come under control and before either gets a set-point.

        Returns
        -------
        bool
            Whether this was the moment; then `restore` brings the axis to its commands.
        """
        if self._hold is None or self._aligned or not self.controls(replica):
            return False
        self._offset = _int32(self._hold - replica.raw[f"{self._name}.position_ref"])
        self._aligned = True
        return True

    def restore(self, replica: Replica) -> None:
        """Bring a newly aligned axis to the commands that the real one has had."""
        mode = self.memory.get("cmd.mode", 0)
        # A mode that is written anew would end the hold that the real axis came under control with.
        variables = ["cmd.mode"] if replica.read_words("cmd.mode")[self._number] != mode else []
        if self._withheld:
            variables.append(_SET_POINTS[mode])
            self._withheld = False
        if self.memory.get("cmd.quick_stop", 0):
            variables.append("cmd.quick_stop")
            self.stopping = True
        for variable in variables:
            if variable in self.memory:
                self._write(replica, variable, self.memory[variable])

    def take_over_rest(self, replica: Replica, sample: Sample) -> bool:
        """Choose the offset anew after a stop, now that both shafts are at rest.

        Returns
        -------
        bool
            Whether it is another one.
        """
        real, twin = activity(sample.labels[self._number]), activity(replica.label(self._number))
        if real is not twin or not (real is Activity.IDLE or self._aligned):
            return False
        self.stopping = False
        if real is Activity.ACTIVE:
            offset = sample.position_ref[self._number] - replica.raw[f"{self._name}.position_ref"]
        else:
            offset = sample.position[self._number] - replica.raw[f"{self._name}.position"]
        offset = _int32(offset)
        changed, self._offset = offset != self._offset, offset
        return changed

    # ---- comparing
    def difference(self, replica: Replica, sample: Sample) -> tuple[str, bool]:
        """What keeps the two from being compared, empty if nothing does, and whether that is a matter of a search."""
        real, twin = sample.labels[self._number], replica.label(self._number)
        if sample.home_states[self._number] == self._homing:
            self.apart_since = sample.tick
            return f"{self._name} is being homed", True
        kinds = {activity(real), activity(twin)}
        alone = twin == "FAULT" != real  # it would not follow when the real axis is enabled
        if (kinds == {Activity.IDLE} and not alone) or (kinds == {Activity.ACTIVE} and self._aligned):
            self.apart_since = None
            return "", False
        if self.apart_since is None:
            self.apart_since = sample.tick
        return f"{self._name} is {real}, its twin {twin}", Activity.SEARCHING in kinds

    def in_real_frame(self, replica: Replica, sample: Sample) -> dict[str, int]:
        """Positions of the twin's axis in the unwrapped frame of the sample [counts], by variable name."""
        near = sample.position[self._number]
        names = [f"{self._name}.{name}" for name in COUNTED_FROM_ZERO]
        return {name: near + _int32(replica.raw[name] + self._offset - near) for name in names}


def _int32(value: int) -> int:
    return (value + 0x8000_0000) % (1 << 32) - 0x8000_0000
