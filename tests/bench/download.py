"""Duration of a download of recorder samples, relative to the wire time of its bytes: ``make bench``.

A virtual board as a process, and the link of the bridge with telemetry. The wire time is that of all bytes in both
directions, including telemetry; the remaining time is waiting for board, computer and adapters.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from chain import Chain, wait_for  # noqa: E402
from servo_bridge.bursts.recording import BurstRecording, Phase, piece_size  # noqa: E402
from servo_bridge.bursts.request import BurstRequest  # noqa: E402
from servo_bridge.telemetry import telemetry_variables  # noqa: E402
from servo_bridge.wire.link import Link, LinkConfig, LinkState  # noqa: E402
from servo_bridge.wire.session import Session  # noqa: E402
from servo_msgs_py.catalogue import Catalogue  # noqa: E402
from servo_msgs_py.table_text import aligned  # noqa: E402

BAUDS: Final = (115_200, 1_000_000)
NAMES: Final = ("tick", "axis1.i_q", "axis1.i_d", "axis2.i_q", "axis2.i_d")
SECONDS: Final = 3.0
RUNS: Final = 3


def wire_bytes(session: Session) -> int:
    """Transferred bytes, both directions."""
    counters = session.client.line.statistics
    return counters.bytes_in + counters.bytes_out


def measure(baud: int) -> dict[str, Any]:
    """Figures of one line speed: the best of several downloads, as other load disturbs."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        return best_of(Chain(Path(folder), baud))


def best_of(chain: Chain) -> dict[str, Any]:
    """Best of several downloads from the board of a chain."""
    samples: list[float] = []
    catalogue = Catalogue.load()
    link = Link(
        LinkConfig(str(chain.port), chain.baud, telemetry=tuple(telemetry_variables(catalogue, ()))),
        catalogue,
        on_sample=lambda _: samples.append(time.monotonic()),
        on_state=lambda _: None,
    )
    try:
        chain.board()
        link.start()
        wait_for(lambda: link.status.state is LinkState.CONNECTED, 30.0, lambda: str(link.status))
        begin, first = time.monotonic(), len(samples)
        time.sleep(SECONDS)
        usual = (len(samples) - first) / (time.monotonic() - begin)
        return min(
            (download(link, catalogue, samples, chain.baud, usual) for _ in range(RUNS)), key=lambda row: row["ratio"]
        )
    finally:
        link.close()
        chain.end()


def download(link: Link, catalogue: Catalogue, samples: list[float], baud: int, usual: float) -> dict[str, Any]:
    """Fill the memory of a recorder and read it during telemetry."""
    recording = BurstRecording(BurstRequest(NAMES), catalogue, piece_size(link.layout.size, baud))
    while recording.phase is not Phase.READING:
        link.call(recording.step).result(10.0)
        time.sleep(recording.pause)
    begin, before, first = time.monotonic(), link.call(wire_bytes).result(10.0), len(samples)
    while link.call(recording.step).result(10.0) is None:
        pass
    seconds = time.monotonic() - begin
    on_wire = (link.call(wire_bytes).result(10.0) - before) * 10 / baud
    return {
        "baud": baud,
        "bytes": recording.size,
        "seconds": seconds,
        "wire_seconds": on_wire,
        "ratio": seconds / on_wire,
        "samples_per_s": (len(samples) - first) / seconds,
        "usual_samples_per_s": usual,
    }


def main() -> int:
    """Measure, print a table, write ``out/bench/download.json``."""
    rows = [measure(baud) for baud in BAUDS]
    cells = [
        ["baud", "bytes", "download [s]", "on the wire [s]", "ratio", "telemetry during it [1/s]", "without [1/s]"]
    ]
    for row in rows:
        times = (f"{row[name]:.2f}" for name in ("seconds", "wire_seconds", "ratio"))
        rates = (f"{row[name]:.0f}" for name in ("samples_per_s", "usual_samples_per_s"))
        cells.append([str(row["baud"]), str(row["bytes"]), *times, *rates])
    print("\n".join(aligned(cells, ">")))
    print("aims: ratio 1.1 at 115200 baud, telemetry at half its rate")
    out = ROOT / "out" / "bench" / "download.json"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
