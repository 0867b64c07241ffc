"""How fast a virtual board is: ``make bench-twin``.

Real-time factors of one board with two axes, both levels in one run, and of several boards on several threads. The
time is that of the thread that runs the board; a factor says how today's machine does, the ratio of the levels lasts.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, get_args

from servo_msgs_py.catalogue import AXES
from servo_twin.board import Board, Level
from servo_twin.simulation import enable

OUT: Final = Path(__file__).resolve().parents[2] / "out" / "bench" / "twin.json"
AIMS: Final[dict[str, float]] = {"registers": 20.0, "ideal": 150.0}
"""Real-time factors of a turning board that are wanted."""

SIMULATED: Final = 1.0  # [s]
ATTEMPTS: Final = 3  # the best counts: others work on this machine, too
THREADS: Final = (1, 2, 4)


def off(board: Board) -> None:
    """Just switched on."""
    board.run(0.1)


def holding(board: Board) -> None:
    """Both axes hold their position."""
    enable(board)
    board.run(0.2)


def turning(board: Board) -> None:
    """Both axes turn."""
    enable(board)
    board.write("cmd.mode", [1] * AXES)
    board.write("cmd.speed", [100.0, -50.0])
    board.run(0.2)


STATES: Final[tuple[Callable[[Board], None], ...]] = (off, holding, turning)


def factor(level: Level, state: Callable[[Board], None]) -> float:
    """Simulated over used time, the best of some attempts."""
    with Board(seed=1, level=level) as board:
        state(board)
        times = []
        for _ in range(ATTEMPTS):
            begin = time.thread_time()
            board.run(SIMULATED)
            times.append(time.thread_time() - begin)
    return SIMULATED / min(times)


def together(level: Level, threads: int) -> float:
    """Real-time factor of all boards together, one per thread, by the clock on the wall."""
    boards = [Board(seed=1 + k, level=level) for k in range(threads)]
    for board in boards:
        turning(board)
    workers = [threading.Thread(target=board.run, args=(SIMULATED,)) for board in boards]
    begin = time.perf_counter()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    used = time.perf_counter() - begin
    for board in boards:
        board.close()
    return threads * SIMULATED / used


def measure() -> dict[str, Any]:
    """Everything, level by level."""
    result: dict[str, Any] = {"cores": os.cpu_count()}
    for level in get_args(Level):
        one = {state.__name__: factor(level, state) for state in STATES}
        many = {str(threads): together(level, threads) for threads in THREADS}
        result[level] = {"one board": one, "boards": many, "aim": AIMS[level]}
    result["ideal over registers"] = (
        result["ideal"]["one board"]["turning"] / result["registers"]["one board"]["turning"]
    )
    return result


def table(figures: dict[str, Any]) -> str:
    """For people."""
    lines = [f"real-time factors, {figures['cores']} cores"]
    for level in get_args(Level):
        entry = figures[level]
        one = ", ".join(f"{name} {value:.1f}" for name, value in entry["one board"].items())
        reached = "reached" if entry["one board"]["turning"] >= entry["aim"] else "missed"
        lines.append(f"  {level:10} one board: {one}; aim {entry['aim']:g}, {reached}")
        many = ", ".join(f"{count}: {value:.1f}" for count, value in entry["boards"].items())
        lines.append(f"  {'':10} turning boards, one per thread, all together: {many}")
    lines.append(f"  the register level takes {figures['ideal over registers']:.1f} times as long")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=OUT, metavar="FILE")
    options = parser.parse_args(arguments)
    figures = measure()
    print(table(figures))
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
