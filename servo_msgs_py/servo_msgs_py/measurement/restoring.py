"""An axis is left as it was found, whatever has ended the measurement. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.measurement.access import BoardAccess, MeasurementError, send_configuration

__all__ = ["AxisState"]

_TRIES: Final = 3
_COMMANDS: Final = ("cmd.i_q", "cmd.speed", "cmd.mode")
_NOT_OF_AN_AXIS: Final = ("param.monitor",)
"""Arrays whose elements are not the axes."""

Step = tuple[str, Callable[[], None]]


class AxisState:
    """Configuration, parameters, mode and set-points of an axis as they are now.

    Parameters
    ----------
    access : BoardAccess
        The board.
    axis : int
        Index of the axis.
    """

    def __init__(self, access: BoardAccess, axis: int) -> None:
        self._access, self._axis = access, axis
        self._block = read_block(access, axis)
        names = [
            name
            for name, variable in access.catalogue.variables.items()
            if name in _COMMANDS
            or (name.startswith("param.") and variable.count == AXES and name not in _NOT_OF_AN_AXIS)
        ]
        self._words = {name: access.read_words(name)[axis] for name in names}
        self._timeout = access.read_words("param.command_timeout")

    def word(self, name: str) -> int:
        """Raw integer of a parameter or set-point of the axis."""
        return self._words[name]

    def restore(self, off: Callable[[], None], stands: Callable[[], None]) -> list[str]:
        """Bring all of it back; each part is tried on its own, and parameters are read back.

        A Ctrl-C meanwhile only repeats the step that it ends.

        Parameters
        ----------
        off : callable
            Switches the axis off, and waits until it stands.
        stands : callable
            Waits until the shaft stands; a configuration of another motor is refused before.

        Returns
        -------
        list of str
            What is not as before, with the reason.
        """

        def configuration() -> None:
            stands()
            send_configuration(self._access, {self._axis: self._block})

        steps: list[Step] = [
            ("outputs off and shaft at rest", off),
            ("configuration", configuration),
            ("param.command_timeout", lambda: self._write("param.command_timeout", self._timeout, 0)),
        ]
        # a configuration brings default values of parameters with it, so these come later; mode and set-points last
        for name in sorted(self._words, key=lambda name: name in _COMMANDS):
            steps.append((name, partial(self._write, name, [self._words[name]], self._axis)))
        return _each(steps)

    def _write(self, name: str, words: Sequence[int], first: int) -> None:
        taken = self._access.write_words(name, words, first)
        if not taken or self._access.read_words(name)[first : first + len(words)] != list(words):
            raise MeasurementError(f"the board refuses {list(words)}")


def _each(steps: Sequence[Step]) -> list[str]:
    """Do all steps, each several times if need be; returns what could not be done."""
    failed: list[str] = []
    for what, step in steps:
        reason = ""
        for _ in range(_TRIES):
            try:
                step()
            except KeyboardInterrupt:
                reason = "ended by Ctrl-C"
            except Exception as error:  # a lost line is an error of the access's own
                reason = str(error) or type(error).__name__
            else:
                reason = ""
                break
        if reason:
            failed.append(f"{what}: {reason}")
    return failed
