"""The exported FMU against the native board, in FMPy: ``make bench-fmu``.

Both run the same moves for a million PWM periods. The bits of all outputs that both have are compared after every step.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from fmpy.model_description import read_model_description
from servo_twin.board import Board
from servo_twin.fmu import export_fmu
from servo_twin.simulation import keep_set_points
from test_fmu import PERIOD_NS, Instance, expected, packed, unpacked

PERIODS: Final = 1_000_000
STEP: Final = 16  # PWM periods: 1 ms
MOVE: Final = 8000  # PWM periods between two moves
SEED: Final = 1


def main() -> int:
    """Print the number of different bits and the times; 1 if there are any."""
    with tempfile.TemporaryDirectory() as name, Board(seed=SEED, level="ideal") as board:
        export_fmu(Path(name) / "board.fmu", seed=SEED)
        description = read_model_description(str(Path(name) / "board.fmu"))
        fmu = Instance(unpacked(Path(name) / "board.fmu"), description)
        keep_set_points(board)
        fmu.start()
        different = 0
        seconds = [0.0, 0.0]
        for period in range(0, PERIODS, STEP):
            if period == 320:
                board.write("cmd.enable", [1, 1])
                for axis in ("axis1", "axis2"):
                    fmu.set(f"{axis}.cmd.enable", 1.0)
            if period >= 2 * MOVE and period % MOVE == 0:
                target = 10.0 if period // MOVE % 2 else -10.0
                board.write("cmd.position", [target, -target])
                fmu.set("axis1.cmd.position", target)
                fmu.set("axis2.cmd.position", -target)
            begin = time.thread_time()
            fmu.step(STEP)
            middle = time.thread_time()
            board.advance(board.time_ns + STEP * PERIOD_NS)
            seconds[0] += middle - begin
            seconds[1] += time.thread_time() - middle
            pairs = zip(fmu.everything(), packed(expected(board, description)), strict=True)
            different += sum((one ^ other).bit_count() for one, other in pairs if one != other)
        fmu.slave.freeInstance()
    simulated = PERIODS * PERIOD_NS * 1e-9
    print(f"{PERIODS} PWM periods, {len(fmu.outputs)} outputs after every {STEP}: {different} bits are different")
    print(f"times real time: FMU {simulated / seconds[0]:.0f}, native board {simulated / seconds[1]:.0f}")
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
