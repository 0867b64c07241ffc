"""Parallel efficiency of a sweep: boards per second on all cores, relative to one core times their number.

``python tests/bench/sweep.py`` (in ``make bench``). The reference is the same trials in this process, one after the
other; the workers' start counts.
"""

from __future__ import annotations

import argparse
import os
import time

from servo_twin.cli import parser
from servo_twin.runner import Runner, run_in_order
from servo_twin.validation.sweep.command import sweep_of
from servo_twin.validation.sweep.trial import Sweep

COUNT = 10_000
REFERENCE = 500
VARY = ("plant.axis1.inertia=*0.5..2 log", "plant.axis2.friction=*0.5..2", "plant.bus.u_source=20..28")


def trials_per_second(sweep: Sweep, workers: int, count: int) -> float:
    """Trials per second."""
    begin = time.perf_counter()
    run_in_order(Runner(workers), sweep, range(count), "sweep, trials")
    return count / (time.perf_counter() - begin)


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--count", type=int, default=COUNT, help="boards, 1 s each (default: %(default)s)")
    count = options.parse_args().count
    words = [word for text in VARY for word in ("--vary", text)]
    sweep = sweep_of(parser().parse_args(["sweep", "move", "--count", str(max(count, REFERENCE)), *words]))
    cores = len(os.sched_getaffinity(0))
    alone = trials_per_second(sweep, 1, REFERENCE)
    together = trials_per_second(sweep, cores, count)
    print(
        f"sweep of {count} boards x 1 s, level ideal: {together:.0f} boards/s on {cores} cores, {alone:.0f} on one: "
        f"{100.0 * together / (cores * alone):.0f} % of {cores} times that (aim 85 %)"
    )


if __name__ == "__main__":
    main()
