"""The firmware from its ELF file: speed beside the linked firmware in the same process, and cycles of the handlers.

Usage: elf.py [--elf FILE] [--seconds SECONDS]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path
from typing import Final

from servo_twin.board import Board
from servo_twin.simulation import enable

ELF: Final = Path(__file__).parents[2] / "firmware" / "port" / "mc56f84789_m4" / "build" / "servo.elf"
CLOCKS_PER_SECOND: Final = 100_000_000
PERIODS_PER_SECOND: Final = 16_000
SLICE: Final = 0.05  # simulated time of one board before it is the other one's turn [s]
ENTER, LEAVE = 8, 9  # chip/trace.h
OVERHEAD: Final = 22  # of entry and return, outside of the marks [cycles]
VECTORS: Final = {85: "M1", 30: "M2", 52: "serial", 28: "edge 1", 24: "edge 2", 87: "start"}


def turning(elf: bytes | None) -> Board:
    """Board with both axes at speed."""
    board = Board(seed=3, level="registers", elf=elf)
    enable(board)
    board.write("cmd.mode", [1, 1])
    board.write("cmd.speed", [100.0, -50.0])
    board.run(0.3)
    return board


def compare(boards: list[Board], seconds: float) -> list[float]:
    """Times real time of each board, by turns."""
    spent = [0.0 for _ in boards]
    for _ in range(round(seconds / SLICE)):
        for k, board in enumerate(boards):
            begin = time.process_time()
            board.run(SLICE)
            spent[k] += time.process_time() - begin
    return [round(seconds / SLICE) * SLICE / one for one in spent]


def handlers(board: Board, seconds: float) -> dict[int, list[int]]:
    """Cycles of each run of each vector, without those of what interrupted it."""
    log = board.trace(board.time_ns + round(seconds * 1e9), 3_000_000)
    found: dict[int, list[int]] = defaultdict(list)
    stack: list[tuple[int, int, int]] = []  # vector, begin, cycles of others
    for clock, kind, a, _ in log.tolist():
        if kind == ENTER:
            stack.append((a, clock, 0))
        elif kind == LEAVE and stack:
            vector, begin, others = stack.pop()
            length = clock - begin + OVERHEAD
            found[vector].append(length - others)
            if stack:
                outer, start, before = stack[-1]
                stack[-1] = (outer, start, before + length)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--elf", type=Path, default=ELF, help="default: that of `make firmware BOARD=mc56f84789_m4`")
    parser.add_argument("--seconds", type=float, default=2.0, help="simulated time (default: %(default)g)")
    options = parser.parse_args()
    boards = [turning(None), turning(options.elf.read_bytes())]
    linked, own = compare(boards, options.seconds)
    print(f"two turning axes: linked firmware {linked:.2f}, ELF {own:.2f} times real time ({own / linked:.2f})")
    for name, board in zip(("linked", "ELF"), boards, strict=True):
        found = handlers(board, 0.2)
        total = sum(sum(lengths) for lengths in found.values()) / 0.2
        share = 100 * total / CLOCKS_PER_SECOND
        print(f"{name}: {total / PERIODS_PER_SECOND:.0f} cycles per PWM period in handlers, {share:.1f} % of the core")
        for vector, lengths in sorted(found.items()):
            mean = sum(lengths) / len(lengths)
            print(f"    {VECTORS.get(vector, str(vector)):8} mean {mean:7.1f} longest {max(lengths)}")


if __name__ == "__main__":
    main()
