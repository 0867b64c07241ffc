"""``servo-tool scope`` with a virtual board on a pty: recordings and telemetry on one time line, read back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chain import Chain
from servo_msgs_py.recording_names import telemetry_parts
from servo_msgs_py.units import PERIOD, SLOW_PERIODS
from servo_twin.view import scene
from servo_twin.view.recording import read_scalars, read_texts

pytest.importorskip("rerun")
pytestmark = [pytest.mark.slow, pytest.mark.realtime]

POINTS, BEFORE = 800, 240
LEVEL = 24.0  # [V], crossed by the noise of the bus


@pytest.fixture
def chain(tmp_path: Path) -> Iterator[Chain]:
    chain = Chain(tmp_path, level="ideal")
    try:
        chain.board()
        yield chain
    finally:
        chain.end()
        print(chain.logs())


def test_names_agree_with_the_viewer_of_the_twin() -> None:
    for quantity in scene.QUANTITIES:
        for source in (scene.BOARD, scene.SET_POINT):
            parts = telemetry_parts(quantity.column(source, 1))
            assert "/" + "/".join(parts) == scene.series_entity(1, quantity.name, source)


def test_recordings_have_the_time_of_the_telemetry(chain: Chain, tmp_path: Path) -> None:
    file = tmp_path / "scope.rrd"
    trigger = ("--trigger", f"u_dc > {LEVEL}", "--before", "30%", "--points", str(POINTS))
    output = chain.tool("scope", "--fast", "u_dc", "axis1.i_a", *trigger, "--count", "2", "--save", str(file))
    assert "2 bursts and" in output.splitlines()[-1]
    times, values = read_scalars(file, scene.burst_entity("u_dc", scene.BOARD))
    assert len(times) == 2 * (POINTS + 1), "a gap ends each burst"
    assert np.isnan(values[[POINTS, -1]]).all()
    first, second = ((times[k : k + POINTS], values[k : k + POINTS]) for k in (0, POINTS + 1))
    rows, u_dc = read_scalars(file, "/plot/u_dc/board")
    for moments, volts in (first, second):
        assert np.diff(moments) == pytest.approx(np.full(POINTS - 1, PERIOD), abs=1e-8)
        assert volts[BEFORE - 1] <= LEVEL < volts[BEFORE]
        # Telemetry of a tick of the recording has the value of that tick.
        inside = np.flatnonzero((rows >= moments[0]) & (rows <= moments[-1]))
        assert len(inside)
        where = np.rint((rows[inside] - moments[0]) / PERIOD).astype(int)
        assert volts[where] == pytest.approx(u_dc[inside], abs=1e-9)
    between = rows[(rows > first[0][-1]) & (rows < second[0][0])]
    assert len(between) > 5, "telemetry continues while a burst is read"
    assert np.rint(np.diff(rows) / PERIOD).astype(int).min() >= SLOW_PERIODS
    assert [text.split()[1] for _, text in read_texts(file, "/log/scope")] == ["1", "2"]
