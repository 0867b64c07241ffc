"""``servo-sim core-speed``: cycles per instruction on silicon, from the widths of the pulses at the scope pins.

The pins F6 and F7 are high while M1 and M2 run (DRM F38). The virtual board executes the same instructions in the same
state of the drive; the measured widths divided by its instructions are the cycles per instruction.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from servo_msgs_py.argument import ParagraphFormatter
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.output_file import write_file
from servo_msgs_py.quantity import Quantity
from servo_msgs_py.table_text import aligned
from servo_msgs_py.text_file import read_text, read_toml
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

from servo_twin.board import Board
from servo_twin.core_speed import DEFAULT_FILE, CoreSpeed
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable
from servo_twin.validation.timing.chip_map import VECTOR_M1, VECTOR_M2
from servo_twin.validation.timing.trace import CLOCK, ChipTrace

HELP: Final = """\
Mean widths of the pulses at the scope pins F6 (M1) and F7 (M2) on the virtual board, in states that are easy to set up
on silicon. --measured FILE reads the widths of a board and writes the cycles per instruction to core.toml. The file has
a table for each measured state, with the mean widths in microseconds:

  [off]       # powered up, not enabled
  m1 = 9.8    # F6
  m2 = 9.5    # F7
  [hold]      # both axes enabled, at rest
  [turning]   # both at 100 rad/s in speed mode

The width can also be calculated from the duty cycle of the pin: duty cycle * 62.5 us."""

STATES: Final = ("off", "hold", "turning")
HANDLERS: Final[Mapping[str, int]] = {"m1": VECTOR_M1, "m2": VECTOR_M2}
"""Vectors of the handlers with a scope pin."""
SPEED: Final = 100.0  # [rad/s]
SETTLE: Final = 0.3  # [s]
PERIODS: Final = 20 * SLOW_PERIODS
SPREAD: Final = 0.15
"""Largest relative deviation of a width from the fit."""


@dataclass(frozen=True)
class Row:
    """One handler in one state."""

    state: str  # state of the drive
    handler: str  # interrupt handler, key of `HANDLERS`
    instructions: float  # mean number of the virtual board
    measured: float  # mean width of the pulse on silicon [clocks]

    @property
    def cycles(self) -> float:
        """Clock cycles per instruction, from this row only."""
        return self.measured / self.instructions


def compare(
    measured: Mapping[str, Mapping[str, float]], instructions: Mapping[str, Mapping[str, float]]
) -> tuple[list[Row], float]:
    """Determine the cycles per instruction from measured widths.

    Parameters
    ----------
    measured : mapping
        Mean widths by state and handler [s].
    instructions : mapping
        Instructions by state and handler.

    Returns
    -------
    list of Row, float
        Rows, and the least-squares fit of the cycles per instruction.

    Raises
    ------
    ValueError
        If there are no widths, or a state, a handler or a width is invalid.
    """
    rows = []
    for state, widths in measured.items():
        if state not in instructions:
            raise ValueError(f"unknown state {state!r}; states: {', '.join(instructions)}")
        for handler, width in widths.items():
            if handler not in instructions[state]:
                raise ValueError(f"{state}: unknown handler {handler!r}; handlers: {', '.join(instructions[state])}")
            if not 0.0 < width <= PERIOD_NS * 1e-9:
                raise ValueError(f"{state}: {handler} = {1e6 * width:g} us is not within 0 .. {1e-3 * PERIOD_NS:g} us")
            rows.append(Row(state, handler, instructions[state][handler], width / CLOCK))
    if not rows:
        raise ValueError("no measured widths")
    products = sum(row.measured * row.instructions for row in rows)
    return rows, products / sum(row.instructions**2 for row in rows)


def with_cycles(core: Path, cycles: float) -> str:
    """Text of a core file with a changed ``cycles_per_instruction``.

    Raises
    ------
    ValueError
        If the file does not contain this value exactly once.
    """
    text, count = re.subn(r"(?m)^(cycles_per_instruction *= *)[0-9.]+", rf"\g<1>{cycles:.2f}", read_text(core))
    if count != 1:
        raise ValueError(f"{core}: write cycles_per_instruction = NUMBER once, at the begin of a line")
    return text


def instructions(core: CoreSpeed, plant: PlantConfig, seed: int) -> dict[str, dict[str, float]]:
    """Mean instructions by state and handler, from a virtual board with one clock cycle per instruction."""
    entry = core.entry_cycles
    result = {}
    with Board(plant, seed=seed, level="registers", core=replace(core, cycles_per_instruction=1.0)) as board:
        for state in STATES:
            _set_up(board, state)
            trace = ChipTrace(board.trace(board.time_ns + PERIODS * PERIOD_NS))
            result[state] = {
                handler: float(np.mean(np.diff(trace.handlers(vector)))) - entry for handler, vector in HANDLERS.items()
            }
    return result


def _set_up(board: Board, state: str) -> None:
    if state == "hold":
        enable(board)
    elif state == "turning":
        board.write("cmd.mode", [1] * AXES)
        board.write("cmd.speed", [SPEED] * AXES)
    board.run(SETTLE)


def add_parser(verbs: Any, common: argparse.ArgumentParser) -> None:
    """Add the command to ``servo-sim``."""
    result = verbs.add_parser(
        "core-speed",
        parents=[common],
        help="pulse widths at the scope pins; calibrate the core with measured widths",
        description=HELP,
        formatter_class=ParagraphFormatter,
    )
    result.add_argument("--measured", type=Path, metavar="FILE", help="mean widths of a board (TOML)")
    result.add_argument("--core", type=Path, default=DEFAULT_FILE, help="core file (default: the packaged one)")
    result.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    core = CoreSpeed.load(args.core)
    with _about(args.measured):
        measured = None if args.measured is None else _widths(args.measured)
    counts = instructions(core, PlantConfig.load(args.plant), args.seed)
    if measured is None:
        each = core.cycles_per_instruction
        rows = [Row(s, h, count, each * count) for s, handlers in counts.items() for h, count in handlers.items()]
        print(_table(rows, each))
        return 0
    with _about(args.measured):
        rows, cycles = compare(measured, counts)
    print(_table(rows, cycles))
    write_file(args.core, with_cycles(args.core, cycles))
    print(f"cycles_per_instruction = {cycles:.2f} in {args.core}")
    if any(abs(row.cycles / cycles - 1.0) > SPREAD for row in rows):
        print(f"poor fit: the deviation of a width is above {SPREAD:.0%}")
        return 1
    return 0


@contextmanager
def _about(path: Path) -> Iterator[None]:
    """Context of the use of a file: a `ValueError` gets its name."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _widths(path: Path) -> dict[str, dict[str, float]]:
    """Read measured widths [s] from a file."""
    result: dict[str, dict[str, float]] = {}
    for state, rows in read_toml(path).items():
        if not isinstance(rows, Mapping) or any(map(Quantity().problem, rows.values())):
            raise ValueError(f"{state} is no table of widths in us; write [STATE], then HANDLER = NUMBER")
        result[state] = {name: 1e-6 * width for name, width in rows.items()}
    return result


def _table(rows: Sequence[Row], cycles: float) -> str:
    cells = [["state", "handler", "instructions", "width [us]", "cycles each", "error"]]
    for r in rows:
        figures = f"{r.instructions:.0f}", f"{1e6 * CLOCK * r.measured:.2f}", f"{r.cycles:.2f}"
        cells.append([r.state, r.handler, *figures, f"{r.cycles / cycles - 1.0:+.0%}"])
    return "\n".join(aligned(cells, "<<>"))
