"""Ends of short programs: every error path of ``servo-command`` many times, beside load; no status may differ.

tests/bench/endings.py [--runs 200]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from chain import FAST_BAUD, Chain, ros_user

PATHS: Final = {
    "follow bad.csv": 2,
    "follow missing.csv": 2,
    "move axis9=1 --time 1": 1,
    "position axis1=1": 1,
    "home axis9 --method stop-positive": 1,
    "zero axis9 1": 1,
    "set param.i_q_limit=1,2,3": 2,
    "get param.nothing": 2,
    "state --check": 1,
    "--namespace /nowhere --wait 0.2 enable": 1,
}
"""Arguments, and the exit status."""


def run(chain: Chain, arguments: str) -> int:
    program = str(Path(sys.executable).with_name("servo-command"))
    done = subprocess.run(
        [program, *arguments.split()], cwd=chain.folder, env=chain.environment, capture_output=True, check=False
    )
    return done.returncode


def main() -> int:
    """Returns 1 if a status differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="of each path (default: %(default)s)")
    runs = parser.parse_args().runs
    wrong = 0
    with tempfile.TemporaryDirectory() as folder, ros_user() as user:
        chain = Chain(Path(folder), FAST_BAUD, level="ideal")
        try:
            chain.board()
            chain.bridge()
            user.until(user.connected, 60.0)
            (chain.folder / "bad.csv").write_text("time,axis1\n0,0\n0,fast\n")
            with ThreadPoolExecutor(4) as pool:  # more than there are cores
                for arguments, expected in PATHS.items():
                    counts = Counter(pool.map(lambda _, a=arguments: run(chain, a), range(runs)))
                    wrong += runs - counts[expected]
                    print(f"{arguments:40s} {dict(counts)}", flush=True)
        finally:
            chain.end()
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
