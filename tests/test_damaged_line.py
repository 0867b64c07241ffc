"""Client and server of the firmware on a line that damages one frame of three."""

from __future__ import annotations

from pathlib import Path

from bench import damage


def test_damaged_frames_cause_no_wrong_read_or_write(tmp_path: Path) -> None:
    report = damage.run(damage.new_server(tmp_path), frames=20_000)
    assert report.damaged >= 20_000
    assert (report.wrong_writes, report.wrong_reads) == (0, 0)
    assert report.failed < 0.25 * report.exchanges
