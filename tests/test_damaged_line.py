"""Client and server of the firmware on a line that damages one frame of three."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench import damage


def test_damaged_frames_cause_no_wrong_read_or_write(tmp_path: Path) -> None:
    report = damage.run(damage.new_server(tmp_path), frames=20_000)
    assert report.damaged >= 20_000
    assert (report.wrong_writes, report.wrong_reads) == (0, 0)
    assert report.failed < 0.25 * report.exchanges


def test_wrong_reads_are_counted_without_a_checksum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a client that accepts damaged answers."""
    monkeypatch.setattr("servo_bridge.freemaster.frames.Framing.intact", lambda self, body: True)
    assert damage.run(damage.new_server(tmp_path), frames=2_000).wrong_reads > 0
