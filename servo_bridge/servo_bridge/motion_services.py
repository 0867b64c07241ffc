"""The services enable, quick_stop and clear_faults. Results are futures of success and message."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.convert import flag_texts
from servo_msgs_py.units import SLOW_PERIODS

from servo_bridge.arbiter import Arbiter
from servo_bridge.board_context import BoardContext
from servo_bridge.dispatcher import Dispatcher
from servo_bridge.outcome import Outcome, answered
from servo_bridge.part import Part
from servo_bridge.set_point_queue import CommandWrite
from servo_bridge.telemetry import Snapshot

_RECHECK = 4 * SLOW_PERIODS
"""PWM periods after which a fault with a persistent cause is set again."""

_ENABLE_TIMEOUT = 40_000
"""PWM periods (2.5 s) after which an enable is answered although the axes are not ready."""


class MotionServices(Part):
    """The three services; called in the thread of the executor.

    Parameters
    ----------
    context : BoardContext
        Texts of faults, and the log.
    joints : sequence of str
        Joint names in the order of the axes.
    arbiter : Arbiter
        Released by ``enable``, blocked by the other services.
    dispatcher : Dispatcher
        Sends the writes.
    """

    def __init__(self, context: BoardContext, joints: Sequence[str], arbiter: Arbiter, dispatcher: Dispatcher) -> None:
        self._catalogue = context.catalogue
        self._input = context.catalogue.flag("limits", "INPUT").mask
        self._joints = list(joints)
        self._arbiter = arbiter
        self._dispatcher = dispatcher
        self._warn = context.warn
        self._snapshot: Snapshot | None = None
        self._reason = "no board since the start"
        self._stops = 0
        self._rechecks: list[tuple[int, Future[Outcome]]] = []
        self._enabling: list[tuple[int, int, Future[Outcome]]] = []  # stops before, last tick, answer

    def on_sample(self, snapshot: Snapshot) -> None:
        """Process the newest sample."""
        if self._snapshot is None and any(axis.accepts_set_points for axis in snapshot.axes):
            # The link has sent a quick stop at the first contact.
            self._warn("the board was enabled at the connection and has been stopped; call enable to continue")
        self._snapshot = snapshot
        self._enabling = [entry for entry in self._enabling if not self._answer_enable(snapshot, *entry)]
        due = [entry for entry in self._rechecks if snapshot.tick >= entry[0]]
        for entry in due:
            self._rechecks.remove(entry)
            faults = self._faults(snapshot)
            entry[1].set_result((not faults, f"not cleared, the cause persists: {faults}" if faults else "no faults"))

    def lost(self, reason: str) -> None:
        """Answer all pending calls."""
        self._snapshot = None
        self._reason = reason
        waiting, self._rechecks = self._rechecks, []
        enabling, self._enabling = self._enabling, []
        for answer in [answer for _, answer in waiting] + [answer for *_, answer in enabling]:
            answer.set_result((False, f"the link was lost: {reason}"))

    # ---- services
    def enable(self, on: bool) -> Future[Outcome]:
        """Enable the axes in use and release set-points; or stop with a ramp and switch the outputs off.

        An enable is answered when set-points are accepted, at the latest after `_ENABLE_TIMEOUT`.
        """
        if not on:
            return self._stop(
                "cmd.enable", 0, "disabled by the service enable", "stopping, then switching the outputs off; see state"
            )
        if self._arbiter.inactive:
            return answered(False, f"{self._arbiter.inactive}; then call enable again")
        snapshot = self._snapshot
        if snapshot is None:
            return answered(False, self._not_connected())
        faults = self._faults(snapshot)
        if faults or self._faulted(snapshot):
            return answered(False, f"{faults or 'an axis is in FAULT'}; then call clear_faults and enable again")
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

        first, last = self._arbiter.used[0], self._arbiter.used[-1]
        write = CommandWrite("cmd.enable", first, (1,) * (last - first + 1))
        self._dispatcher.urgent(write).add_done_callback(written)
        return answer

    def _answer_enable(self, snapshot: Snapshot, stops: int, last_tick: int, answer: Future[Outcome]) -> bool:
        """Answer an enable, unless the axes are not ready yet; returns whether it was answered."""
        if stops != self._stops:
            outcome = False, "interrupted by a stop; call enable again"
        elif self._arbiter.armed:
            names = [self._joints[axis] for axis in self._arbiter.used]
            enabled = "both axes are" if len(names) == AXES else f"{names[0]} is"
            outcome = True, f"{enabled} enabled; set-points are accepted"
        elif self._faulted(snapshot):
            outcome = (
                False,
                f"{self._faults(snapshot) or 'an axis is in FAULT'}; then call clear_faults and enable again",
            )
        elif snapshot.tick >= last_tick and (held := self._held(snapshot)):
            outcome = False, f"{held}; then call enable again"
        elif snapshot.tick >= last_tick:
            labels = ", ".join(f"{self._joints[axis]} is in {snapshot.axes[axis].label}" for axis in self._arbiter.used)
            outcome = True, f"enabling in progress: {labels}; set-points are accepted when armed is true"
        else:
            return False
        answer.set_result(outcome)
        return True

    def quick_stop(self, reason: str = "stopped by the service quick_stop") -> Future[Outcome]:
        """Stop as ``param.on_quick_stop`` says; set-points are refused for `reason` until ``enable``."""
        return self._stop(
            "cmd.quick_stop",
            1,
            reason,
            "stopping, then position hold; call enable with data: true to release set-points",
        )

    def clear_faults(self) -> Future[Outcome]:
        """Clear the faults whose cause is gone; the axes stay disabled."""
        snapshot = self._snapshot
        if snapshot is None:
            return answered(False, self._not_connected())
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
        """Block set-points at once, then write."""
        self._stops += 1
        self._arbiter.block(reason)
        if self._snapshot is None:
            return answered(False, self._not_connected())
        return self._write(_both(variable, value), lambda: (True, message))

    def _write(self, write: CommandWrite, done: Callable[[], Outcome]) -> Future[Outcome]:
        answer: Future[Outcome] = Future()

        def written(result: Future[int]) -> None:
            error = result.exception()
            answer.set_result(done() if error is None else (False, str(error)))

        self._dispatcher.urgent(write).add_done_callback(written)
        return answer

    def _faulted(self, snapshot: Snapshot) -> bool:
        return any(snapshot.axes[axis].faulted for axis in self._arbiter.used)

    def _faults(self, snapshot: Snapshot) -> str:
        """Text of the faults of the axes in use; empty without faults."""
        return "; ".join(
            f"{self._joints[axis]}: {text}"
            for axis in self._arbiter.used
            for text in flag_texts(self._catalogue, "faults", snapshot.faults[axis])
        )

    def _held(self, snapshot: Snapshot) -> str:
        """Text of the inputs that keep an axis in STOP; empty if there are none."""
        words = {
            axis: int(snapshot.values.get(f"{axis_name(axis)}.limits", 0)) & self._input for axis in self._arbiter.used
        }
        return "; ".join(
            f"{self._joints[axis]}: {text}"
            for axis, word in words.items()
            if snapshot.axes[axis].label == "STOP"
            for text in flag_texts(self._catalogue, "limits", word)
        )

    def _not_connected(self) -> str:
        return f"not connected: {self._reason}; after param.host_timeout the board stops the axes (HOST_SILENT)"


def _both(variable: str, value: int) -> CommandWrite:
    """Write of the same number to all axes."""
    return CommandWrite(variable, 0, (value,) * AXES)
