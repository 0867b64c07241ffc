"""Runs the tuning code in a separate process (0.5 s of CPU time), so that the node is not delayed.

The program reads the path of a file from standard input and writes the response to standard output, both as JSON.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_tuning.errors import ConfigError
from servo_tuning.remedies import explained

from servo_bridge.tuning.plan import Computed, computed

_TIMEOUT: Final = 60.0  # [s]


class ComputationError(RuntimeError):
    """The process ended without a response."""


class TuningProcess:
    """Starts a process for each request. Blocking; used by one thread, except `close`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._closed = False

    def computed(self, path: Path) -> Computed:
        """As `servo_bridge.tuning.plan.computed`.

        Raises
        ------
        ConfigError
            If the configuration cannot work, or the file cannot be read.
        ComputationError
            If there is no response.
        """
        return self._request(path)

    def close(self) -> None:
        """Kill a running process; no other is started."""
        with self._lock:
            self._closed = True
            if self._process is not None:
                self._process.kill()

    def _request(self, path: Path) -> Computed:
        command = with_parent_death_signal([sys.executable, "-m", __name__])
        pipe = subprocess.PIPE
        with self._lock:
            if self._closed:
                raise ComputationError("the bridge is ending")
            # Separate session: Ctrl-C in the terminal is handled by the node, which ends this process.
            self._process = process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, encoding="utf-8", start_new_session=True
            )
        try:
            output, errors = process.communicate(json.dumps(str(path)), timeout=_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise ComputationError(f"the tuning code took more than {_TIMEOUT:g} s") from None
        finally:
            with self._lock:
                self._process = None
        if process.returncode != 0:
            raise ComputationError(f"the tuning code failed: {(errors.strip().splitlines() or ['it was ended'])[-1]}")
        answer = json.loads(output)
        if "refused" in answer:
            raise ConfigError(answer["refused"])
        return Computed(*answer["result"])


def main() -> int:
    """Process one request; returns the exit status."""
    try:
        answer: dict[str, Any] = {"result": computed(Path(json.load(sys.stdin)), Catalogue.load())}
    except ConfigError as error:
        answer = {"refused": str(explained(error))}
    except OSError as error:
        answer = {"refused": error.strerror or str(error)}
    json.dump(answer, sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
