"""Recorder of version 3: one per target, with one edge trigger of fixed threshold."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from servo_bridge.freemaster.commands import Request
from servo_bridge.freemaster.commands_v3 import MemoryForm
from servo_bridge.freemaster.errors import RecorderError, Status, StatusError
from servo_bridge.freemaster.frames import V3
from servo_bridge.freemaster.line import SendRequest
from servo_bridge.freemaster.recorder import Compare, Limits, SampleMemory, Setup, State, Trigger

_SLOTS_MAX: Final = 8
_NUMBER_MAX: Final = 0xFFFF

_OFF, _RISING, _FALLING = 0, 1, 2
_COMPARE: Final = {Compare.UNSIGNED: 0, Compare.SIGNED: 1, Compare.FLOAT: 3}
_STATUSES: Final = (Status.RECORDER_RUNNING, Status.RECORDER_STOPPED)


def set_up(form: MemoryForm, setup: Setup) -> Request:
    """Request that configures the recorder.

    Raises
    ------
    RecorderError
        If version 3 does not support the trigger.
    """
    trigger, mode = setup.trigger, _OFF
    if trigger is None:
        trigger = Trigger(setup.slots[0], Compare.UNSIGNED, above=True, below=False)
    elif trigger.threshold_address is not None or trigger.level or trigger.above == trigger.below:
        raise RecorderError(
            "a version 3 target supports one edge through a fixed threshold as trigger, no level or variable threshold"
        )
    else:
        mode = _RISING if trigger.above else _FALLING
    if trigger.slot.size > 4:
        raise RecorderError("a version 3 target does not support triggers on variables of 8 bytes")
    payload = (
        bytes((mode,))
        + form.number(setup.points, 2)
        + form.number(setup.points - 1 - setup.before, 2)
        + form.number(setup.divider - 1, 2)
        + form.address(trigger.slot.address)
        + bytes((trigger.slot.size, _COMPARE[trigger.compare]))
        + form.number(trigger.threshold & 0xFFFF_FFFF, 4)
        + form.slots(setup.slots)
    )
    return Request(
        f"SETUPREC {len(setup.slots)} variables", 0x0B if form.wide else 0x09, payload, 0, framing=V3, lengthy=True
    )


class RecorderV3:
    """Recorder of a version 3 target; see `Recorder`.

    Parameters
    ----------
    send : callable
        Sends a request.
    form : MemoryForm
        Form of addresses and numbers.
    memory : int or None
        Memory size [bytes]; None: not reported.
    period_ns : int
        Time between two samples [ns]; 0: not reported.
    payload_limit : int
        Largest payload of the target [bytes].
    """

    def __init__(
        self, send: SendRequest, form: MemoryForm, memory: int | None, period_ns: int, payload_limit: int
    ) -> None:
        self._send = send
        self._form = form
        self._limits = Limits(
            "", memory, period_ns, slots_max=_SLOTS_MAX, divider_max=_NUMBER_MAX + 1, points_max=_NUMBER_MAX
        )
        self._payload_limit = payload_limit
        self._setup: Setup | None = None
        self._started = False

    def limits(self) -> Limits:
        return self._limits

    def configure(self, setup: Setup) -> int:
        self._limits.check(setup)
        points = setup.points or self._limits.capacity(setup)
        if points is None:
            raise RecorderError("the board does not report the memory size of its recorder; set the number of points")
        setup = replace(setup, points=points)
        request = set_up(self._form, setup)
        if len(request.payload) > self._payload_limit:
            raise RecorderError(f"{len(setup.slots)} variables are too many for the buffer of the board; record fewer")
        try:
            self._send(request)
        except StatusError as error:
            if error.code == Status.UNKNOWN_COMMAND:
                raise RecorderError("the board has no recorder") from error
            if error.code == Status.BAD_SIZE:
                raise RecorderError(
                    f"{points} points of {len(setup.slots)} variable(s) do not fit the memory of the recorder; "
                    "record fewer points"
                ) from error
            if error.code == Status.BAD_BUFFER:
                raise RecorderError(f"{len(setup.slots)} variables are too many for the recorder") from error
            raise
        self._setup, self._started = setup, False
        return points

    def start(self) -> None:
        self._send(Request("STARTREC", 0xC1, b"", 0, framing=V3, statuses=_STATUSES, lengthy=True))
        self._started = True

    def stop(self) -> None:
        self._send(Request("STOPREC", 0xC2, b"", 0, framing=V3, statuses=_STATUSES, lengthy=True))

    def state(self) -> State:
        try:
            status = self._send(Request("GETRECSTS", 0xC3, b"", 0, framing=V3, statuses=_STATUSES)).status
        except StatusError as error:
            if error.code != Status.NOT_INITIALISED:
                raise
            return State.UNCONFIGURED
        if status == Status.RECORDER_RUNNING:
            return State.RUNNING
        return State.FULL if self._started else State.EMPTY

    def memory(self) -> SampleMemory:
        if self._setup is None:
            raise RecorderError("the recorder has not been set up")
        size = self._form.address_size
        request = Request("GETRECBUFF", 0xC9 if self._form.wide else 0xC4, b"", size + 2, framing=V3)
        data = self._send(request).data
        address, first = self._form.value(data[:size]), self._form.value(data[size:])
        return SampleMemory(address, self._setup.point_size, self._setup.points, first)
