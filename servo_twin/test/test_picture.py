"""The picture of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.rerun_file import RecordingError
from servo_twin.view import scene
from servo_twin.view.picture import draw, figure, main
from servo_twin.view.recording import Recording
from servo_twin.view.viewer import Viewer
from viewer_rig import CATALOGUE, COLUMNS, EVERY, START_NS, move, points, stamp, telemetry

pytest.importorskip("rerun")
image = pytest.importorskip("matplotlib.image")


def _record(file: Path, *, twin: bool = True, samples: int = 1000) -> None:
    viewer = Viewer(Recording(file), CATALOGUE, START_NS)
    viewer.start()
    viewer.board(telemetry(move(lag=0.01, samples=samples)))
    if twin:
        viewer.twin(telemetry(move(lag=0.02, samples=samples)))
        for k in range(samples):
            viewer.residual(stamp(EVERY * k), {"position": [0.004, -0.003], "velocity": [], "effort": []})
    assert viewer.close()


def _has(picture: NDArray[np.floating], source: str) -> bool:
    """Whether the colour of a source is in a picture."""
    colour = np.array(scene.COLOURS[source]) / 255.0
    return bool((np.abs(picture[..., :3] - colour).max(axis=-1) < 0.06).sum() > 300)


def test_the_picture_shows_set_point_board_twin_and_residual(tmp_path: Path) -> None:
    file, png = tmp_path / "run.rrd", tmp_path / "out" / "run.png"
    _record(file)
    draw(file, png)
    picture = image.imread(png)
    assert picture.shape[:2] == (1000, 1600)
    # The set-point is drawn translucent.
    for source in (scene.BOARD, scene.TWIN, scene.RESIDUAL):
        assert _has(picture, source), source


def test_curves_lie_at_their_times_in_turns_and_counts(tmp_path: Path) -> None:
    _record(tmp_path / "run.rrd")
    position, _, speed, _, residual, _ = figure(tmp_path / "run.rrd").axes
    curves = {line.get_label(): np.asarray(line.get_xydata()) for line in position.lines}
    assert list(curves) == ["set-point", "board", "twin"]
    for name, lag in (("set-point", 0.0), ("board", 0.01), ("twin", 0.02)):
        times, turns = curves[name].T
        # Half of 5 turns in the middle of the move from 1 s to 3 s.
        assert np.interp(2.0 + lag, times, turns) == pytest.approx(2.5, abs=1e-3), name
    board = np.asarray(speed.lines[1].get_xydata())
    assert board[np.argmax(board[:, 1]), 0] == pytest.approx(2.01, abs=0.01)
    assert board[:, 1].max() == pytest.approx(10 * np.pi * 0.75, rel=1e-3)
    assert set(np.round(np.asarray(residual.lines[0].get_ydata()), 6)) == {round(0.004 * 4000 / (2 * np.pi), 6)}
    # From shortly before the first movement to shortly after the last one.
    assert position.get_xlim() == pytest.approx((0.51, 3.5), abs=0.05)


def test_a_path_is_drawn_as_one_axis_over_the_other(tmp_path: Path) -> None:
    viewer = Viewer(Recording(tmp_path / "run.rrd"), CATALOGUE, START_NS)
    viewer.start()
    rows = move(lag=0.01)
    viewer.applied(points(375 * EVERY, 625 * EVERY, replaces=True))
    viewer.board(telemetry(rows))
    assert viewer.close()
    *_, plane, error = figure(tmp_path / "run.rrd").axes
    set_point, board = (np.asarray(line.get_xydata()) for line in plane.lines)
    assert set_point[:, 1] == pytest.approx(-0.4 * set_point[:, 0], abs=1e-9)
    assert board[:, 1] == pytest.approx(-0.4 * board[:, 0], abs=1e-9)
    assert plane.get_aspect() == 1.0
    first, second = (np.asarray(line.get_ydata()) for line in error.lines)
    place, reference = (rows[375:626, COLUMNS.index(f"axis1.{name}")] for name in ("position", "position_ref"))
    assert np.abs(first).max() == pytest.approx(np.abs(place - reference).max() * 4000 / (2 * np.pi))
    assert second == pytest.approx(-0.4 * first)


def test_without_a_twin_there_is_a_picture_of_the_board(tmp_path: Path) -> None:
    file, png = tmp_path / "run.rrd", tmp_path / "run.png"
    _record(file, twin=False)
    assert main([str(file), str(png)]) == 0
    picture = image.imread(png)
    assert _has(picture, scene.BOARD)
    assert not _has(picture, scene.TWIN)


def test_shafts_at_rest_make_a_picture_too(tmp_path: Path) -> None:
    _record(tmp_path / "run.rrd", samples=1)
    draw(tmp_path / "run.rrd", tmp_path / "run.png")
    assert image.imread(tmp_path / "run.png").shape[:2] == (1000, 1600)


def test_an_empty_recording_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "empty.rrd"
    viewer = Viewer(Recording(file), CATALOGUE, START_NS)
    viewer.start()
    assert viewer.close()
    with pytest.raises(RecordingError, match="contains no telemetry of a board: record with a connected bridge"):
        draw(file, tmp_path / "run.png")
    assert main([str(file), str(tmp_path / "run.png")]) == 1
    assert "contains no telemetry" in capsys.readouterr().err
    assert not (tmp_path / "run.png").exists()


def test_a_missing_recording_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "none.rrd"), str(tmp_path / "run.png")]) == 1
    assert "no such recording" in capsys.readouterr().err
