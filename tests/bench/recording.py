"""Recording of a run: processor time and size at 24 variables and 200 Hz, and files of killed recorders.

The messages are those of a bridge and a twin while both axes move, with the resolution of the board. The aim of the
size is for the telemetry alone, which determines the others: of all messages already the index that rosbag2 needs, 16
bytes for each, takes 8.5 MB.
"""

from __future__ import annotations

import argparse
import math
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any, Final

from rclpy.serialization import serialize_message
from servo_bridge.runs.recorder import RunRecorder
from servo_msgs_py.convert import joint_state, snapshot_message
from servo_msgs_py.run_file.reader import RunReader
from servo_msgs_py.run_file.series import Limits
from servo_msgs_py.run_file.topic import Topic, type_of
from servo_msgs_py.run_file.writer import RunWriter
from std_msgs.msg import Float64

RATE: Final = 200  # samples [Hz]
COLUMNS: Final = [f"axis{k % 2 + 1}.variable{k}" for k in range(24)]
LSB: Final = 1.0 / 32768.0
CPU_MAX, SIZE_MAX, LOSS_MAX = 0.05, 10.0, 1.0  # aims: of a core; MB per 10 min; s before the kill
LOST: Final = Topic("/servo/run_lost", "std_msgs/msg/UInt64")


def messages(sample: int, random_: random.Random) -> Iterator[tuple[str, Any]]:
    """Messages of one sample: topic and message."""
    stamp = 1_700_000_000_000_000_000 + sample * 5_000_000

    def values(count: int) -> list[float]:
        clean = (math.sin(sample / 150.0 + k) * 0.3 + random_.gauss(0.0, 2.0 * LSB) for k in range(count))
        return [round(value / LSB) * LSB for value in clean]

    for name in ("/servo/joint_states", "/twin/joint_states", "/twin/residual"):
        yield name, joint_state(("axis1", "axis2"), stamp, values(2), values(2), values(2))
    if sample % 4 == 0:
        for name in ("/servo/snapshot", "/twin/snapshot"):
            yield name, snapshot_message(COLUMNS, [values(len(COLUMNS)) for _ in range(4)])
    if sample % 10 == 0:
        for k in range(9):
            yield f"/servo/var/{k}", Float64(data=values(1)[0])


def size_of(path: Path, seconds: float, topics: Container[str]) -> float:
    """Size of a recording of these topics [MB per 10 min]."""
    random_ = random.Random(1)
    with RunWriter(path) as writer:
        for sample in range(round(seconds * RATE)):
            for name, message in messages(sample, random_):
                if name in topics:
                    topic = Topic(name, type_of(type(message)))
                    writer.write(topic, serialize_message(message), sample * 1_000_000_000 // RATE)
            if sample % (RATE // 2) == 0:
                writer.flush()
    return path.stat().st_size * 600.0 / seconds * 1e-6


def record(path: Path, seconds: float) -> float:
    """Record at the rate of the board; returns the processor time of the recorder [s]."""
    begun = threading.Event()
    recorder = RunRecorder(path, Limits(), {}, LOST, lambda _: begun.set(), lambda _: None)
    begun.wait()
    (thread,) = (each for each in threading.enumerate() if each.name == "run recorder")
    clock = time.pthread_getcpuclockid(thread.ident or 0)
    before, start, random_ = time.clock_gettime(clock), time.monotonic(), random.Random(1)
    for sample in range(round(seconds * RATE)):
        for name, message in messages(sample, random_):
            recorder.add(Topic(name, type_of(type(message))), serialize_message(message), time.time_ns())
        time.sleep(max(start + sample / RATE - time.monotonic(), 0.0))
    used = time.clock_gettime(clock) - before
    recorder.end()
    recorder.join()
    return used


def killed(path: Path, random_: random.Random) -> float:
    """Time of the last message of a recorder before it is killed [s]; infinity if nothing can be read."""
    command = [sys.executable, __file__, "--child", str(path)]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while not path.exists() or path.stat().st_size < 1000:
        time.sleep(0.05)
    time.sleep(random_.uniform(0.0, 2.0))
    child.kill()
    end = time.time()
    child.wait()
    last = max((record.time_ns for record in RunReader(path).records()), default=0)
    return end - last * 1e-9


def main() -> int:
    """Print the figures; exit status 1 if an aim is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="duration of the measurement of processor and size")
    parser.add_argument("--kills", type=int, default=100, help="number of killed recorders")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        record(args.child, 60.0)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "run.mcap")
        cpu = record(path, args.seconds) / args.seconds
        everything = path.stat().st_size * 600.0 / args.seconds * 1e-6
        size = size_of(Path(folder, "telemetry.mcap"), args.seconds, ("/servo/snapshot",))
        random_ = random.Random(2)
        losses = [killed(Path(folder, f"killed{k}.mcap"), random_) for k in range(args.kills)]
    loss = max(losses, default=0.0)
    print(f"recorder: {100.0 * cpu:.1f} % of a core (aim {100.0 * CPU_MAX:.0f} %)")
    print(f"size: telemetry {size:.1f} MB per 10 min (aim {SIZE_MAX:.0f}), all topics {everything:.1f} MB")
    print(f"killed {args.kills} times: the last {loss:.2f} s are missing at most (aim {LOSS_MAX:.0f} s)")
    return int(cpu > CPU_MAX or size > SIZE_MAX or loss > LOSS_MAX)


if __name__ == "__main__":
    sys.exit(main())
