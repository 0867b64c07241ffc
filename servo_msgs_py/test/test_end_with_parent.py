"""Children that end with their parent."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal

pytestmark = pytest.mark.realtime


def test_missing_program_is_reported() -> None:
    with pytest.raises(FileNotFoundError, match="/no/such/program is not an executable program"):
        with_parent_death_signal(["/no/such/program"])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel ends the child on Linux only")
def test_child_does_not_start_if_its_parent_has_died() -> None:
    command = with_parent_death_signal([sys.executable, "-c", "print('begun')"])
    position = command.index(str(os.getpid()))
    orphan = [*command[:position], str(os.getpid() + 1), *command[position + 1 :]]
    for line, status, text in ((command, 0, "begun\n"), (orphan, 143, "")):
        done = subprocess.run(line, capture_output=True, text=True, timeout=20.0, check=False)
        assert (done.returncode, done.stdout) == (status, text)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_the_started_program_ignores_no_signal() -> None:
    lines = [["grep", "SigIgn", "/proc/self/status"], with_parent_death_signal(["grep", "SigIgn", "/proc/self/status"])]
    alone, bound = (subprocess.run(line, capture_output=True, text=True, timeout=20.0, check=True) for line in lines)
    assert bound.stdout == alone.stdout


def test_program_that_cannot_be_executed_is_reported(tmp_path: Path) -> None:
    broken = tmp_path / "script"
    broken.write_text("#!/no/such/interpreter\n")
    broken.chmod(0o755)
    done = subprocess.run(
        with_parent_death_signal([str(broken)]), capture_output=True, text=True, timeout=20.0, check=False
    )
    assert (done.returncode, done.stderr) == (1, f"{broken} cannot be started: No such file or directory\n")
