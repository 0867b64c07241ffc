"""A path is claimed by one living program, under every spelling of its name."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from servo_msgs_py.runtime.claim import ClaimError, claimed

HOLDER = """
import sys, time
from pathlib import Path
from servo_msgs_py.runtime.claim import claimed
with claimed(Path(sys.argv[1])):
    print("claimed", flush=True)
    time.sleep(60)
"""


def test_a_path_is_claimed_once_under_every_spelling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, link = tmp_path / "folder", tmp_path / "link"
    folder.mkdir()
    link.symlink_to(folder)
    monkeypatch.chdir(folder)
    with claimed(folder / "file"):
        for same in (Path("file"), folder / "file", link / "file", folder / ".." / "folder" / "file"):
            with pytest.raises(ClaimError, match=f"{same} is used by another running program"), claimed(same):
                pass
        with claimed(folder / "other"):
            pass
    with claimed(link / "file"):
        pass


def test_a_killed_program_claims_nothing(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with subprocess.Popen([sys.executable, "-c", HOLDER, path], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "claimed\n"
        with pytest.raises(ClaimError), claimed(path):
            pass
        holder.kill()
        holder.wait()
        with claimed(path):
            pass
