"""Every sequence of four events (`command_sequences`), by hand; the tests run a small sample.

    .venv/bin/python tests/command_campaign.py --processes 2            # 20736 sequences
    .venv/bin/python tests/command_campaign.py --first 20736            # the same events with other values
    .venv/bin/python tests/command_campaign.py --first 800 --minutes 30 # from 800 on, as many as there is time for
    .venv/bin/python tests/command_campaign.py --show 1234              # one of them, with the log of the bridge

Exit status 1: a motion was not permitted.
"""

from __future__ import annotations

import argparse
import itertools
import math
import random
import sys
import time
from collections.abc import Sequence
from multiprocessing import Pool

from command_sequences import EVENTS, SETUP_VALUES, STEP_VALUES, CommandSequence, Setup, Step
from motion_permission import Violation

LENGTH = 4
COUNT = len(EVENTS) ** LENGTH
STRIDE = 7919
"""Prime: consecutive numbers have different events, and COUNT numbers have all of them."""

_PROGRESS = 50
"""Sequences between two reports."""


def numbered(number: int) -> tuple[Setup, list[Step]]:
    """Sequence of a number: its events by their index, all other values drawn with the number as seed."""
    draw = random.Random(number)
    setup = Setup(**{name: draw.choice(values) for name, values in SETUP_VALUES.items()})
    index = number * STRIDE % COUNT
    events = next(itertools.islice(itertools.product(EVENTS, repeat=LENGTH), index, None))
    steps = [Step(event, **{name: draw.choice(values) for name, values in STEP_VALUES.items()}) for event in events]
    return setup, steps


def run(number: int) -> tuple[int, list[Violation]]:
    """Run a sequence; returns its number and its violations."""
    return number, CommandSequence(*numbered(number)).run()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, metavar="NUMBER")
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no sequence after this time")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--show", type=int, metavar="NUMBER")
    options = parser.parse_args(arguments)
    if options.show is not None:
        setup, steps = numbered(options.show)
        sequence = CommandSequence(setup, steps)
        violations = sequence.run()
        print(setup, *steps, *sequence.log, *violations, sep="\n")
        return 1 if violations else 0
    begin, done, found = time.monotonic(), 0, 0
    with Pool(options.processes) as pool:
        for number, violations in pool.imap(run, range(options.first, options.first + options.count)):
            done += 1
            if done % _PROGRESS == 0:
                print(f"{done} of {options.count}, {found} with violations", file=sys.stderr, flush=True)
            if violations:
                found += 1
                events = ", ".join(step.event for step in numbered(number)[1])
                first = violations[0]
                print(f"{number} ({events}): {first.time:.2f} s, axis {first.axis}: {first.text}", flush=True)
            if time.monotonic() - begin > 60.0 * options.minutes:
                break
    last = options.first + done - 1
    print(f"{options.first} to {last}, {done} of {COUNT}: {found} with violations, {time.monotonic() - begin:.0f} s")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
