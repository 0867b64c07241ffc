"""Telemetry rate and latency of the whole chain, relative to the limit of the line: ``make bench``.

Virtual board and bridge as processes, a user on ROS topics. Rates are those received by the user; the limit is the rate
of the line if request and answer followed each other without a pause. The latency of a set-point is the time from its
publication to the tick at which the firmware applied it, both on the ROS clock.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from chain import Chain, User, ros_user, rows_of  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from servo_msgs_py.convert import applied_from_message  # noqa: E402
from servo_msgs_py.table_text import aligned  # noqa: E402
from servo_msgs_py.units import PERIOD_NS  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

CASES = ((115200, 0.0, 200), (1_000_000, 0.0, 200), (1_000_000, 200.0, 10_000))
"""Line speed [bit/s], parameter ``telemetry_rate`` [Hz], number of set-points."""
SECONDS = 5.0
STREAM_PERIOD = 0.01
"""Period of the stream that is sent to both axes [s]."""
AIMS = "at 1 Mbaud and 200 Hz: 2.0, 5.0, 20.0 ms; 20 % of a core"


def rate(user: User) -> tuple[float, float]:
    """Samples per second of joint_states, and bytes per second on the line in both directions."""
    first, start = len(user.messages["/servo/joint_states"]), user.wait_board_time(SECONDS)
    samples = len(user.messages["/servo/joint_states"]) - first
    rows = user.rows(start)
    span = (rows[-1]["tick"] - rows[0]["tick"]) * PERIOD_NS * 1e-9
    values = {entry.key: entry.value for entry in user.status("servo/servo_bridge: link").values}
    return samples / span, float(values["bytes/s in"]) + float(values["bytes/s out"])


def latencies(user: User, count: int) -> list[float]:
    """Latency from publishing a position to the tick of its effect [ms], one set-point at a time.

    Lists of messages are emptied at every set-point: work that grows with them would delay the user, not the bridge.
    """
    applied, snapshots = user.messages["/servo/commands_applied"], user.messages["/servo/snapshot"]
    result = []
    for number in range(count):
        for messages in user.messages.values():
            messages[:-1] = []
        applied.clear()
        begin = user.node.get_clock().now().nanoseconds
        user.position[0].publish(Float64(data=0.01 * (number % 2)))
        user.until(lambda: applied, 5.0, "no set-point took effect")
        tick = applied_from_message(applied[0]).tick
        user.until(lambda tick=tick: rows_of(snapshots[-1])[-1]["tick"] >= tick, 5.0, "no telemetry")  # type: ignore[misc]
        row = rows_of(snapshots[-1])[-1]
        stamp = int(row["stamp.sec"]) * 1_000_000_000 + int(row["stamp.nanosec"])
        result.append((stamp - (row["tick"] - tick) * PERIOD_NS - begin) * 1e-6)
    return result


POINTS = [f"axis{n}.points_{what}" for n in (1, 2) for what in ("taken", "late")] + ["points_refused"]


def streamed(baud: int) -> dict[str, Any]:
    """Samples per second during a stream of both axes at 100 Hz, and counts of its points."""
    chain = Chain(Path(tempfile.mkdtemp(prefix="bench-")), baud)
    with ros_user() as user:
        try:
            chain.board()
            bridge = chain.bridge()
            user.until(user.connected, 30.0, "the bridge is not connected")
            user.enable_axes()
            joints, omega, sent = ["axis1", "axis2"], 2.0 * math.pi, 0
            snapshots = user.messages["/servo/snapshot"]
            first = len(snapshots)
            begin = time.monotonic()
            while (now := time.monotonic() - begin) < SECONDS:
                if now >= sent * STREAM_PERIOD:
                    rise = min(now, 1.0)
                    position = 0.5 * rise * math.sin(omega * now)
                    velocity = 0.5 * (
                        rise * omega * math.cos(omega * now) + (math.sin(omega * now) if now < 1.0 else 0.0)
                    )
                    user.joint_commands.publish(
                        JointState(name=joints, position=[position] * 2, velocity=[velocity] * 2)
                    )
                    sent += 1
                user.executor.spin_once(timeout_sec=0.002)
            rows = user.rows(first)
            span = (rows[-1]["tick"] - rows[0]["tick"]) * PERIOD_NS * 1e-9
            user.enable(False)
            bridge.stop()
            points = chain.read_variables(*POINTS)
        finally:
            chain.end()
    return {"baud": baud, "samples_per_s": (len(rows) - 1) / span, "messages_per_s": sent / SECONDS, **points}


def measure(baud: int, telemetry_rate: float, count: int) -> dict[str, Any]:
    """Figures of one line speed and rate of telemetry."""
    chain = Chain(Path(tempfile.mkdtemp(prefix="bench-")), baud)
    with ros_user() as user:
        try:
            chain.board()
            bridge = chain.bridge(telemetry_rate=telemetry_rate)
            user.until(user.connected, 30.0, "the bridge is not connected")
            user.enable_axes()
            samples, carried = rate(user)
            begin, used = time.monotonic(), bridge.cpu_seconds()
            delays = latencies(user, count)
            load = (bridge.cpu_seconds() - used) / (time.monotonic() - begin)
            user.enable(False)
        finally:
            chain.end()
    return {
        "baud": baud,
        "telemetry_rate": telemetry_rate,
        "set_points": count,
        "samples_per_s": samples,
        "bytes_per_s": carried,
        "wire_bytes_per_s": baud / 10,
        "part_of_the_wire": carried / (baud / 10),
        "latency_p50_ms": float(np.percentile(delays, 50)),
        "latency_p99_ms": float(np.percentile(delays, 99)),
        "latency_max_ms": max(delays),
        "cpu_of_a_core": load,
    }


def main() -> int:
    """Measure, print a table, write ``out/bench/telemetry.json``."""
    rows = [measure(*case) for case in CASES]
    heads = ["baud", "samples/s", "bytes/s", "of the wire", "set-points", "to effect p50 [ms]", "p99", "largest"]
    cells = [[*heads, "CPU of the bridge"]]
    for row in rows:
        rates = (f"{row[name]:.0f}" for name in ("baud", "samples_per_s", "bytes_per_s"))
        delays = (f"{row[f'latency_{name}_ms']:.1f}" for name in ("p50", "p99", "max"))
        part, load = (f"{row[name]:.0%}" for name in ("part_of_the_wire", "cpu_of_a_core"))
        cells.append([*rates, part, str(row["set_points"]), *delays, load])
    print("\n".join(aligned(cells, ">")))
    print(f"aims {AIMS}")
    stream = streamed(115200)
    taken = [stream[f"axis{n}.points_taken"] / SECONDS for n in (1, 2)]
    print(
        f"stream of both axes at 115200 baud: {stream['messages_per_s']:.0f} messages/s, points/s {taken[0]:.0f} and "
        f"{taken[1]:.0f}, late {stream['axis1.points_late']} and {stream['axis2.points_late']}, writes refused "
        f"{stream['points_refused']}, beside {stream['samples_per_s']:.0f} samples/s (aim 100 points/s each, 100)"
    )
    rows.append(stream)
    out = ROOT / "out" / "bench" / "telemetry.json"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
