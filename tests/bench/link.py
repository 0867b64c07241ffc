"""Cost of a lost frame on the serial line: ``make bench``.

A fake target on a pseudo terminal, in a separate process, whose answers take the time of the line, and that does not
answer every `LOST`-th request. The cost is the duration of an exchange with one loss minus the median without a loss.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "servo_bridge" / "test"))

from fake_port import FakePort  # noqa: E402
from fake_target import FakeTarget  # noqa: E402
from servo_bridge.freemaster.client import Client  # noqa: E402
from servo_bridge.freemaster.commands import ScopeSlot  # noqa: E402
from servo_bridge.freemaster.line import Line  # noqa: E402
from servo_bridge.wire.serial_port import SerialPort  # noqa: E402
from servo_msgs_py.table_text import aligned  # noqa: E402

BAUDS = (115_200, 1_000_000)
VARIABLES = (8, 24)
EXCHANGES = 2000
LOST = 20
"""One of this number of requests is not answered."""


class Lossy:
    """A target that does not answer some scope requests."""

    def __init__(self) -> None:
        self.target = FakeTarget(mtu=254, scope_limit=28, safety=False)
        self.count = 0

    def feed(self, data: bytes) -> bytes:
        answer = self.target.feed(data)
        self.count += data.startswith(b"+\x27")
        return b"" if data.startswith(b"+\x27") and self.count % LOST == 0 else answer


def serve(link: Path, baud: int, up: Event, end: Event) -> None:
    """Run the target until `end`."""
    with FakePort(link, Lossy(), baud):
        up.set()
        end.wait()


@contextmanager
def a_target(baud: int) -> Iterator[str]:
    """A target in a separate process; yields its port."""
    up, end = multiprocessing.Event(), multiprocessing.Event()
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        link = Path(folder) / "tty"
        process = multiprocessing.Process(target=serve, args=(link, baud, up, end))
        process.start()
        try:
            up.wait()
            yield str(link)
        finally:
            end.set()
            process.join()


def measure(baud: int, variables: int) -> dict[str, Any]:
    """Round trip and cost of a loss for a scope of 16-bit variables."""
    with a_target(baud) as path, SerialPort(path, baud) as port:
        client = Client(Line(port, baud=baud))
        client.identify()
        request = client.set_scope([ScopeSlot(0x1000 + 2 * k, 2) for k in range(variables)])
        usual: list[float] = []
        lost: list[float] = []
        for _ in range(EXCHANGES):
            retries, begin = client.line.statistics.retries, time.monotonic()
            client.exchange(request)
            seconds = time.monotonic() - begin
            losses = client.line.statistics.retries - retries
            if losses < 2:
                (lost if losses else usual).append(1e3 * seconds)
    round_trip = float(np.median(usual))
    cost = np.array(lost) - round_trip
    return {
        "baud": baud,
        "variables": variables,
        "round_trip_ms": round_trip,
        "losses": len(lost),
        "cost_p50_ms": float(np.median(cost)),
        "cost_p95_ms": float(np.percentile(cost, 95)),
        "round_trips": float(np.median(cost)) / round_trip,
    }


def main() -> int:
    """Measure, print a table, write ``out/bench/link.json``."""
    rows = [measure(baud, variables) for baud in BAUDS for variables in VARIABLES]
    cells = [["baud", "variables", "losses", "round trip [ms]", "a loss costs p50 [ms]", "p95 [ms]", "in round trips"]]
    for row in rows:
        times = (f"{row[name]:.2f}" for name in ("round_trip_ms", "cost_p50_ms", "cost_p95_ms"))
        counts = (str(row[name]) for name in ("baud", "variables", "losses"))
        cells.append([*counts, *times, f"{row['round_trips']:.1f}"])
    print("\n".join(aligned(cells, ">")))
    print("aim below 3 round trips at 115200 baud")
    out = ROOT / "out" / "bench" / "link.json"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
