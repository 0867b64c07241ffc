"""Client and server of the firmware on a line that damages one frame of three."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench import damage


def test_damage_changes_nothing_that_was_not_meant(tmp_path: Path) -> None:
    report = damage.run(damage.new_server(tmp_path), frames=20_000)
    assert report.damaged >= 20_000
    assert (report.wrong_writes, report.wrong_reads) == (0, 0)
    assert report.failed < 0.25 * report.exchanges


def test_the_measurement_sees_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that takes damaged answers, too."""
    monkeypatch.setattr("servo_bridge.freemaster.frames.Framing.intact", lambda self, body: True)
    assert damage.run(damage.new_server(tmp_path), frames=2_000).wrong_reads > 0
