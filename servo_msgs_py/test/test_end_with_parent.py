"""Children that end with their parent."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from servo_msgs_py.end_with_parent import bound_to_us

pytestmark = pytest.mark.realtime


def test_a_program_that_is_not_there_is_named() -> None:
    with pytest.raises(FileNotFoundError, match="there is no program /no/such/program"):
        bound_to_us(["/no/such/program"])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel ends the child on Linux only")
def test_a_child_whose_parent_died_before_it_could_ask_does_not_begin() -> None:
    command = bound_to_us([sys.executable, "-c", "print('begun')"])
    position = command.index(str(os.getpid()))
    orphan = [*command[:position], str(os.getpid() + 1), *command[position + 1 :]]
    for line, status, text in ((command, 0, "begun\n"), (orphan, 143, "")):
        done = subprocess.run(line, capture_output=True, text=True, timeout=20.0, check=False)
        assert (done.returncode, done.stdout) == (status, text)
