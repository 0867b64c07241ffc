"""How fast a virtual board is: ``make bench-twin``.

Real-time factors of one board with two axes, both levels in one run, and of several boards on several threads; who
takes the instructions; and a simulator that others use, on one drive in the same run. The time is that of the board's
thread; a factor says how today's machine does, ratios and counts of instructions last.
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

from peer.environment import motulator
from servo_msgs_py.catalogue import AXES
from servo_twin.board import Board, Level
from servo_twin.simulation import enable
from shares import shares

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


def measure(peer: bool, counted: bool) -> dict[str, Any]:
    """Everything, level by level."""
    result: dict[str, Any] = {"cores": os.cpu_count()}
    for level in get_args(Level):
        one = {state.__name__: factor(level, state) for state in STATES}
        many = {str(threads): together(level, threads) for threads in THREADS}
        result[level] = {"one board": one, "boards": many, "aim": AIMS[level]}
        if counted:
            result[level]["instructions"] = shares(level)
    result["ideal over registers"] = (
        result["ideal"]["one board"]["turning"] / result["registers"]["one board"]["turning"]
    )
    if peer:
        result["motulator"] = motulator()
    return result


def _shares(counts: dict[str, float] | str) -> str:
    if isinstance(counts, str):
        return counts
    total = sum(counts.values())
    parts = ", ".join(f"{part} {count / total:.0%}" for part, count in sorted(counts.items(), key=lambda c: -c[1]))
    return f"{total:.0f} instructions per PWM period: {parts}"


def _peer(figures: dict[str, Any]) -> list[str]:
    peer = figures["motulator"]
    if isinstance(peer, str):
        return [f"  {peer}"]
    lines = [f"  motulator {peer['version']}, one drive instead of two, no fixed point, no encoder, no converter:"]
    for level, model in (("registers", "switching"), ("ideal", "averaged")):
        times = figures[level]["one board"]["turning"] / peer[model]
        lines.append(
            f"  {'':10} {model} {peer[model]:.3f}; the board at the level {level} is {times:.0f} times as fast"
        )
    return lines


def table(figures: dict[str, Any]) -> str:
    """For people."""
    lines = [f"real-time factors, {figures['cores']} cores"]
    for level in get_args(Level):
        entry = figures[level]
        one = ", ".join(f"{name} {value:.1f}" for name, value in entry["one board"].items())
        reached = "reached" if entry["one board"]["turning"] >= entry["aim"] else "missed"
        lines.append(f"  {level:10} one board: {one}; aim {entry['aim']:g}, {reached}")
        single = entry["boards"]["1"]
        many = ", ".join(f"{n}: {value:.1f} (x {value / single:.1f})" for n, value in entry["boards"].items())
        lines.append(f"  {'':10} turning boards, one per thread, all together: {many}")
        if "instructions" in entry:
            lines.append(f"  {'':10} {_shares(entry['instructions'])}")
    lines.append(f"  the register level takes {figures['ideal over registers']:.1f} times as long")
    if "motulator" in figures:
        lines += _peer(figures)
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=OUT, metavar="FILE")
    parser.add_argument("--no-peer", action="store_true", help="do not install motulator under out/ and run it")
    parser.add_argument("--no-shares", action="store_true", help="do not count instructions with valgrind")
    options = parser.parse_args(arguments)
    figures = measure(not options.no_peer, not options.no_shares)
    print(table(figures))
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
