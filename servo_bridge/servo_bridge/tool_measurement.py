"""What the commands that measure a running axis share: their options, and a measurement with messages."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from servo_measurement.bode_plan import GAIN_MIN
from servo_measurement.options import add_range
from servo_msgs_py.quantity import Quantity
from servo_msgs_py.runtime.program import complain, deferred

from servo_bridge.measurement_access import measurement_access
from servo_bridge.tool_progress import progress_bar, show
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.wire.session import Session

_Result = TypeVar("_Result")


def add_loop_options(command: argparse.ArgumentParser, gain: float | None, default: str) -> None:
    """Options of a command that measures a closed loop; `gain`: default of --gain, and its text."""
    add_range(command)
    command.add_argument(
        "--gain",
        type=_part,
        default=gain,
        metavar="PART",
        help="bandwidths of speed and position control during the measurement, over those of the board: a part for a"
        f" shaft that oscillates (default: {default})",
    )
    add_enable(command)


def add_enable(command: argparse.ArgumentParser) -> None:
    """Option of a command that measures a running axis."""
    command.add_argument("--enable", action="store_true", help="enable the axis, and disable it afterwards")


def measured(session: Session, measure: Callable[..., _Result]) -> _Result:
    """Measure with a progress bar and messages.

    Parameters
    ----------
    session : Session
        The board.
    measure : callable
        Called with an access to the board and the callables ``report`` and ``progress``, see
        `servo_measurement.bode.measure`.
    """
    with deferred() as stop, measurement_access(session, stop.check) as access, progress_bar() as bar:
        return measure(
            access,
            report=lambda sentence: complain(f"servo-tool: {sentence}"),
            progress=lambda text, done, total: show(bar, f"{text} ", done, total),
        )


def _part(text: str) -> float:
    return argument.finite(text, Quantity(minimum=GAIN_MIN, maximum=1.0))
