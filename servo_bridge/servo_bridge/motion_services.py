"""What the services enable, quick_stop and clear_faults do. Pure; answers are futures of success and message."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future

from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import flag_texts
from servo_msgs_py.units import SLOW_PERIODS

from servo_bridge.arbiter import Arbiter
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.telemetry import Snapshot

Outcome = tuple[bool, str]
"""Success and message."""

_RECHECK = 4 * SLOW_PERIODS
"""PWM periods after which a fault whose cause is still there has come back."""

_ENABLE_TIMEOUT = 40_000
"""PWM periods (2.5 s) after which an enable is answered though the axes are still on their way."""


class MotionServices:
    """The three services; all of it in the executor's thread.

    Parameters
    ----------
    catalogue : Catalogue
        For the texts of faults.
    joints : sequence of str
        Joint names in the order of the axes.
    arbiter : Arbiter
        Its gate is opened by ``enable`` and shut by everything else.
    dispatcher : Dispatcher
        Carries the writes.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        joints: Sequence[str],
        arbiter: Arbiter,
        dispatcher: Dispatcher,
        on_event: Callable[[str], None],
    ) -> None:
        self._catalogue = catalogue
        self._input = catalogue.flag("limits", "INPUT").mask
        self._joints = list(joints)
        self._arbiter = arbiter
        self._dispatcher = dispatcher
        self._on_event = on_event
        self._snapshot: Snapshot | None = None
        self._reason = "the board has not been seen yet"
        self._stops = 0
        self._rechecks: list[tuple[int, Future[Outcome]]] = []
        self._enabling: list[tuple[int, int, Future[Outcome]]] = []  # stops before, last tick, answer

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Take the newest sample."""
        if self._snapshot is None and any(axis.spinning for axis in snapshot.axes):
            # The link has stopped it at first contact.
            self._on_event("the board was still enabled: it has been stopped; call enable to go on")
        self._snapshot = snapshot
        self._enabling = [entry for entry in self._enabling if not self._answer_enable(snapshot, *entry)]
        due = [entry for entry in self._rechecks if snapshot.tick >= entry[0]]
        for entry in due:
            self._rechecks.remove(entry)
            faults = self._faults(snapshot)
            entry[1].set_result((not faults, f"still there: {faults}" if faults else "no faults"))

    def link_lost(self, reason: str) -> None:
        """Answer every call that waits."""
        self._snapshot = None
        self._reason = reason
        waiting, self._rechecks = self._rechecks, []
        enabling, self._enabling = self._enabling, []
        for answer in [answer for _, answer in waiting] + [answer for *_, answer in enabling]:
            answer.set_result((False, f"the link was lost: {reason}"))

    # ---- services
    def enable(self, on: bool) -> Future[Outcome]:
        """Switch both axes on, and let set-points through again; or ramp down and switch off.

        The answer to an enable comes when a set-point would pass, at the latest after `_ENABLE_TIMEOUT`.
        """
        if not on:
            return self._stop(
                "cmd.enable", 0, "disabled by the service enable", "ramping down and switching off; see state"
            )
        if self._arbiter.inactive:
            return _answered(False, f"{self._arbiter.inactive}; then call enable again")
        snapshot = self._snapshot
        if snapshot is None:
            return _answered(False, self._not_connected())
        faults = self._faults(snapshot)
        if faults or any(axis.faulted for axis in snapshot.axes):
            return _answered(False, f"{faults or 'an axis is in FAULT'}; then call clear_faults and enable again")
        stops = self._stops

        answer: Future[Outcome] = Future()

        def written(result: Future[int]) -> None:
            error = result.exception()
            if error is not None:
                answer.set_result((False, str(error)))
                return
            if stops == self._stops:
                self._arbiter.release()
            self._enabling.append((stops, result.result() + _ENABLE_TIMEOUT, answer))

        self._dispatcher.urgent(_both("cmd.enable", 1)).add_done_callback(written)
        return answer

    def _answer_enable(self, snapshot: Snapshot, stops: int, last_tick: int, answer: Future[Outcome]) -> bool:
        """Answer an enable that took effect, unless the axes are still on their way."""
        if stops != self._stops:
            outcome = False, "a stop came in between; call enable again"
        elif self._arbiter.armed:
            outcome = True, "both axes are on; set-points are let through"
        elif any(axis.faulted for axis in snapshot.axes):
            outcome = (
                False,
                f"{self._faults(snapshot) or 'an axis is in FAULT'}; then call clear_faults and enable again",
            )
        elif snapshot.tick >= last_tick and (held := self._held(snapshot)):
            outcome = False, f"{held}; then call enable again"
        elif snapshot.tick >= last_tick:
            labels = ", ".join(
                f"{joint} is in {axis.label}" for joint, axis in zip(self._joints, snapshot.axes, strict=True)
            )
            outcome = True, f"switching on, not ready yet: {labels}; set-points are let through when armed is true"
        else:
            return False
        answer.set_result(outcome)
        return True

    def quick_stop(self, reason: str = "stopped by the service quick_stop") -> Future[Outcome]:
        """Ramp down at the limit and hold; set-points stay refused, for this reason, until ``enable`` is called."""
        return self._stop(
            "cmd.quick_stop",
            1,
            reason,
            "stopping at the limit, then holding; call enable with data: true to let set-points through again",
        )

    def clear_faults(self) -> Future[Outcome]:
        """Clear the faults whose cause is gone; nothing is switched on by it."""
        snapshot = self._snapshot
        if snapshot is None:
            return _answered(False, self._not_connected())
        answer: Future[Outcome] = Future()

        def written(done: Future[int]) -> None:
            error = done.exception()
            if error is not None:
                answer.set_result((False, str(error)))
            else:
                self._rechecks.append((done.result() + _RECHECK, answer))

        self._dispatcher.urgent(_both("cmd.clear_faults", 1)).add_done_callback(written)
        return answer

    # ---- details
    def _stop(self, variable: str, value: int, reason: str, message: str) -> Future[Outcome]:
        """Shut the gate at once, then write."""
        self._stops += 1
        self._arbiter.block(reason)
        if self._snapshot is None:
            return _answered(False, self._not_connected())
        return self._write(_both(variable, value), lambda: (True, message))

    def _write(self, write: CommandWrite, done: Callable[[], Outcome]) -> Future[Outcome]:
        answer: Future[Outcome] = Future()

        def written(result: Future[int]) -> None:
            error = result.exception()
            answer.set_result(done() if error is None else (False, str(error)))

        self._dispatcher.urgent(write).add_done_callback(written)
        return answer

    def _faults(self, snapshot: Snapshot) -> str:
        """Faults of all axes as text, empty when there are none."""
        return "; ".join(
            f"{joint}: {text}"
            for joint, word in zip(self._joints, snapshot.faults, strict=True)
            for text in flag_texts(self._catalogue, "faults", word)
        )

    def _held(self, snapshot: Snapshot) -> str:
        """What the inputs of axes say that have stayed in STOP, empty when there are none."""
        word = (int(snapshot.values.get(f"{axis_name(axis)}.limits", 0)) & self._input for axis in range(AXES))
        return "; ".join(
            f"{joint}: {text}"
            for joint, axis, limits in zip(self._joints, snapshot.axes, word, strict=True)
            if axis.label == "STOP"
            for text in flag_texts(self._catalogue, "limits", limits)
        )

    def _not_connected(self) -> str:
        return f"not connected: {self._reason}; outputs that were on go off when the board misses its host"


def _both(variable: str, value: int) -> CommandWrite:
    """Write of the same number to every axis."""
    return CommandWrite(variable, 0, (value,) * AXES)


def _answered(success: bool, message: str) -> Future[Outcome]:
    """A future that is done."""
    future: Future[Outcome] = Future()
    future.set_result((success, message))
    return future
