"""From telemetry to a recording on disk, read with the reader of rerun."""

from __future__ import annotations

import builtins
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.convert import AppliedCommand
from servo_msgs_py.joints import Joint
from servo_msgs_py.rerun_file import RecordingError
from servo_msgs_py.units import PERIOD_NS
from servo_twin.view import scene
from servo_twin.view.recording import Recording, read_scalars, read_texts
from servo_twin.view.viewer import Change, Viewer
from viewer_rig import CATALOGUE, COLUMNS, EVERY, FAULT, START_NS, move, points, stamp, telemetry, verify

pytest.importorskip("rerun")

OVER_CURRENT = 1 << 2


@pytest.fixture(autouse=True)
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make rerun raise an error instead of a warning."""
    monkeypatch.setenv("RERUN_STRICT", "1")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "run.rrd"


@pytest.fixture
def record(file: Path) -> Callable[[Callable[[Viewer], None]], Viewer]:
    """Records the data that a function passes to the viewer."""

    def run(feed: Callable[[Viewer], None]) -> Viewer:
        viewer = Viewer(Recording(file), CATALOGUE, START_NS)
        viewer.start()
        feed(viewer)
        assert viewer.close()
        assert viewer.failure == ""
        return viewer

    return run


Record = Callable[[Callable[[Viewer], None]], Viewer]


def test_every_state_has_a_colour(record: Record, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rerun draws a state without one in the colours of a warning."""
    configured: set[str] = set()
    shown: set[tuple[str, str]] = set()
    static, state = Recording._static, Recording.state

    def log_static(self: Recording, entity: str, component: Any) -> None:
        if type(component).__name__ == "StateConfiguration":
            configured.add(entity)
        static(self, entity, component)

    def log_state(self: Recording, name: str, time: float, label: str) -> None:
        shown.add((name, label))
        state(self, name, time, label)

    monkeypatch.setattr(Recording, "_static", log_static)
    monkeypatch.setattr(Recording, "state", log_state)

    def feed(viewer: Viewer) -> None:
        homes = [f"{name}.home_state" for _, name in scene.axes()]
        table = move()
        for value in CATALOGUE.enums["home_state_t"].values():
            viewer.board(telemetry(np.hstack([table, np.full((len(table), 2), float(value))]), [*COLUMNS, *homes]))
        viewer.link(stamp(0), "")
        viewer.healthy(stamp(0), True)
        viewer.changes(stamp(0), [], {})

    record(feed)
    assert len(shown) > 10
    assert {scene.state_entity(name) for name, _ in shown} <= configured
    assert {label for _, label in shown} <= set(scene.STATE_COLOURS)
    assert set(scene.HOME_STATES) == set(CATALOGUE.enums["home_state_t"])


def read_strips(file: Path, entity: str) -> list[NDArray[np.float64]]:
    """Strips of a curve in the plane, in the order of time."""
    from rerun.chunk import RrdReader

    component = "LineStrips2D:strips"
    found: list[tuple[int, Any]] = []
    for chunk in RrdReader(file).stream().filter(content=entity, is_static=False, components=component):
        batch = chunk.to_record_batch()
        times = np.asarray(batch[scene.TIMELINE].cast("int64")).tolist()
        found += zip(times, batch[component].to_pylist(), strict=True)
    return [np.array(strips[0]) for _, strips in sorted(found, key=lambda pair: pair[0])]


def test_curves_of_board_and_twin_are_recorded_at_their_ticks(record: Record, file: Path) -> None:
    board, twin = move(lag=0.01), move(lag=0.011)

    def feed(viewer: Viewer) -> None:
        for k in range(0, 1000, 10):
            viewer.board(telemetry(board[k : k + 10]))
            viewer.twin(telemetry(twin[k : k + 10]))

    viewer = record(feed)
    assert viewer.dropped == 0
    result = verify(file)
    assert result.returncode == 0, result.stderr
    expected = EVERY * np.arange(1000) * PERIOD_NS * 1e-9
    for axis in (0, 1):
        for quantity in scene.QUANTITIES:
            for source, table in ((scene.SET_POINT, board), (scene.BOARD, board), (scene.TWIN, twin)):
                times, values = read_scalars(file, scene.series_entity(axis, quantity.name, source))
                assert times == pytest.approx(expected, abs=2e-9), (axis, quantity.name, source)
                assert np.array_equal(values, table[:, COLUMNS.index(quantity.column(source, axis))])


@pytest.mark.parametrize("extra", scene.EXTRAS, ids=lambda extra: extra.name)
def test_more_curves_are_shown_where_the_telemetry_has_them(record: Record, file: Path, extra: scene.Quantity) -> None:
    column = extra.column(scene.BOARD, 0)
    values = np.linspace(-1.0, 0.0, 1000)
    record(lambda viewer: viewer.board(telemetry(np.column_stack([values, move()]), [column, *COLUMNS])))
    assert np.array_equal(read_scalars(file, scene.series_entity(0, extra.name, scene.BOARD))[1], values)


def test_the_board_is_recorded_without_a_twin(record: Record, file: Path) -> None:
    record(lambda viewer: viewer.board(telemetry(move())))
    assert verify(file).returncode == 0
    assert len(read_scalars(file, scene.series_entity(0, "position", scene.BOARD))[0]) == 1000
    assert len(read_scalars(file, scene.series_entity(0, "position", scene.TWIN))[0]) == 0


def test_twin_data_from_before_the_first_board_sample_are_omitted(record: Record, file: Path) -> None:
    rows = move()

    def feed(viewer: Viewer) -> None:
        # Messages of the twin may arrive before those of the board.
        viewer.twin(telemetry(rows[:100]))
        viewer.residual(stamp(0), {"position": [0.1, 0.1]})
        viewer.residual(stamp(EVERY * 550), {"position": [0.1, 0.1]})
        viewer.board(telemetry(rows[400:600]))
        viewer.twin(telemetry(rows[300:500]))
        for row in (300, 450):
            viewer.residual(stamp(EVERY * row), {"position": [0.1, 0.1]})

    record(feed)
    times, _ = read_scalars(file, scene.series_entity(0, "speed", scene.TWIN))
    assert times == pytest.approx(np.arange(400, 500) * 0.004, abs=1e-6)
    assert read_scalars(file, scene.residual_entity(0, "position"))[0] == pytest.approx([1.8, 2.2], abs=1e-6)


def test_a_twin_without_stamps_is_placed_by_the_ticks_of_the_board(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        viewer.board(telemetry(move()))
        viewer.twin(telemetry(move()[:, :-2], COLUMNS[:-2]))

    record(feed)
    twin, board = (read_scalars(file, scene.series_entity(0, "i_q", s))[0] for s in (scene.TWIN, scene.BOARD))
    assert twin == pytest.approx(board, abs=2e-9)


@pytest.mark.parametrize("width", [len(COLUMNS), len(COLUMNS) - 2])
def test_twin_data_without_a_board_are_not_recorded(record: Record, file: Path, width: int) -> None:
    record(lambda viewer: viewer.twin(telemetry(move()[:, :width], COLUMNS[:width])))
    assert len(read_scalars(file, scene.series_entity(0, "i_q", scene.TWIN))[0]) == 0
    assert verify(file).returncode == 0


def test_positions_and_speeds_are_those_of_the_joints(record: Record, file: Path) -> None:
    joints = [Joint("lift", 50.0, -1, 0.3), Joint("pan")]

    def feed(viewer: Viewer) -> None:
        viewer.joints(joints)
        viewer.board(telemetry(move()))

    record(feed)
    rows = move()
    for name, convert in (("position", joints[0].position), ("speed", joints[0].velocity)):
        shown = read_scalars(file, scene.series_entity(0, name, scene.BOARD))[1]
        assert shown == pytest.approx(convert(rows[:, COLUMNS.index(f"axis1.{name}")]))
    motor = read_scalars(file, scene.series_entity(0, "i_q", scene.BOARD))[1]
    assert motor == pytest.approx(rows[:, COLUMNS.index("axis1.i_q")])


def test_residuals_lie_at_the_ticks_of_their_samples(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        viewer.board(telemetry(move()))
        for tick in (640, 1280):
            viewer.residual(stamp(tick), {"position": [0.1, -0.2], "velocity": [1.0, 2.0], "effort": []})

    record(feed)
    times, values = read_scalars(file, scene.residual_entity(1, "position"))
    assert times == pytest.approx([0.04, 0.08], abs=2e-9)
    assert values.tolist() == [-0.2, -0.2]
    assert len(read_scalars(file, scene.residual_entity(1, "effort"))[0]) == 0


def test_states_and_faults_are_logged_at_their_tick_with_cause_and_remedy(record: Record, file: Path) -> None:
    rows = move()
    words = [COLUMNS.index(f"axis2.{name}") for name in ("state", "substate", "faults")]
    rows[600:700, words] = (*FAULT, OVER_CURRENT)

    def feed(viewer: Viewer) -> None:
        for part in np.array_split(rows, 37):
            viewer.board(telemetry(part))

    record(feed)
    states = read_texts(file, scene.state_entity("axis2"), "StateChange:state")
    assert [state for _, state in states] == ["STOP", "RUN/SPIN", "FAULT", "RUN/SPIN"]
    assert [moment for moment, _ in states] == pytest.approx([0.0, 0.5, 2.4, 2.8], abs=1e-6)
    lines = read_texts(file, "/log/axis2")
    flag = next(flag for flag in CATALOGUE.flags["faults"] if flag.mask == OVER_CURRENT)
    fault = next((moment, text) for moment, text in lines if flag.cause in text)
    assert fault[0] == pytest.approx(2.4)
    assert flag.name in fault[1]
    assert flag.remedy in fault[1]
    cleared = [moment for moment, text in lines if text == f"axis2: {flag.name} cleared"]
    assert cleared == pytest.approx([2.8])
    levels = dict(read_texts(file, "/log/axis2", "TextLog:level"))
    assert "ERROR" in levels.values()
    assert [text for _, text in read_texts(file, "/log/axis1")] == ["axis1: STOP", "axis1: STOP -> RUN/SPIN"]


def test_the_axes_are_drawn_over_each_other_while_they_follow_a_path(record: Record, file: Path) -> None:
    rows = move(lag=0.01)

    def feed(viewer: Viewer) -> None:
        viewer.board(telemetry(rows[:250]))
        viewer.applied(points(300 * EVERY, 400 * EVERY, replaces=True))
        viewer.applied(points(500 * EVERY, 600 * EVERY, replaces=False))
        for k in range(250, 1000, 50):
            viewer.board(telemetry(rows[k : k + 50]))

    record(feed)
    states = read_texts(file, scene.state_entity("path"), "StateChange:state")
    assert [state for _, state in states] == ["NO PATH", "ON PATH", "NO PATH"]
    assert [moment for moment, _ in states] == pytest.approx([0.0, 300 * 0.004, 601 * 0.004], abs=1e-6)
    for source, column in ((scene.SET_POINT, "position_ref"), (scene.BOARD, "position")):
        drawn = np.concatenate(read_strips(file, scene.path_entity(source)))
        expected = rows[300:601][:, [COLUMNS.index(f"axis{n}.{column}") for n in (1, 2)]]
        # A strip begins at the end of the previous one; the vertical axis of the view points downwards.
        places = np.unique(drawn, axis=0)
        assert len(places) == len(np.unique(expected.astype(np.float32), axis=0))
        assert np.abs(drawn[0] - expected[0] * (1, -1)).max() < 1e-5
        assert np.abs(drawn[-1] - expected[-1] * (1, -1)).max() < 1e-5


def test_a_stop_ends_a_path(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        viewer.applied(points(100 * EVERY, 400 * EVERY, replaces=True))
        viewer.applied(AppliedCommand("cmd.quick_stop", 200 * EVERY, (1, 1), 3))
        viewer.board(telemetry(move()))

    record(feed)
    moments = [moment for moment, _ in read_texts(file, scene.state_entity("path"), "StateChange:state")]
    assert moments == pytest.approx([0.0, 100 * 0.004, 201 * 0.004], abs=1e-6)


def test_the_link_and_the_twin_have_states(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        viewer.link(START_NS + 50_000_000, "no board answers on /dev/ttyUSB0")
        viewer.board(telemetry(move(start_ns=START_NS + 100_000_000, samples=10)))
        viewer.link(START_NS + 100_000_000, "")
        viewer.link(START_NS + 101_000_000, "")
        viewer.healthy(START_NS + 120_000_000, True)
        viewer.healthy(START_NS + 130_000_000, True)
        viewer.healthy(START_NS + 140_000_000, False)
        viewer.link(START_NS + 400_000_000, "the port vanished")

    record(feed)
    link = read_texts(file, scene.state_entity("link"), "StateChange:state")
    assert [state for _, state in link] == ["DISCONNECTED", "CONNECTED", "DISCONNECTED"]
    assert [moment for moment, _ in link] == pytest.approx([0.05, 0.1, 0.4], abs=1e-6)
    twin = read_texts(file, scene.state_entity("twin"), "StateChange:state")
    assert [state for _, state in twin] == ["HEALTHY", "NOT HEALTHY"]
    axis = read_texts(file, scene.state_entity("axis1"), "StateChange:state")
    assert [state for _, state in axis] == ["STOP", "DISCONNECTED"]
    texts = [text for _, text in read_texts(file, "/log/link")]
    assert texts[0] == "link: DISCONNECTED no board answers on /dev/ttyUSB0"
    assert texts[-1] == "link: DISCONNECTED the port vanished"


def test_diagnostics_are_logged_on_change(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        viewer.board(telemetry(move(samples=20)))
        for seconds, level, message in (
            (0, 0, "163 samples/s"),
            (1, 0, "164 samples/s"),
            (2, 1, "in the last second: 2 timeouts"),
            (3, 1, "in the last second: 3 timeouts"),
            (12, 1, "in the last second: 3 crc errors"),
            (30, 1, "in the last second: 3 crc errors"),
            (31, 0, "160 samples/s"),
        ):
            viewer.diagnosis(START_NS + seconds * 1_000_000_000, "servo_bridge: link", level, message)
        viewer.diagnosis(START_NS + 32_000_000_000, "servo_bridge: board", 3, "silent")

    record(feed)
    texts = [text.removeprefix("diagnostics: servo_bridge: ") for _, text in read_texts(file, "/log/diagnostics")]
    assert texts == [
        "link: in the last second: 2 timeouts",
        "link: in the last second: 3 crc errors",
        "link: 160 samples/s",
        "board: silent",
    ]


def test_changes_are_states_and_estimates_are_curves(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        viewer.board(telemetry(move(samples=500)))
        for k in range(8):
            found = [Change("axis2", "single", "friction", f"friction {2.0 + 0.01 * k:.2f} times")] if k >= 4 else []
            numbers = {"value": 1.0 + 0.1 * k, "low": 0.9, "high": 2.0}
            estimates = {("axis2", "friction"): numbers, ("bus", "supply"): numbers}
            viewer.changes(START_NS + k * 250_000_000, found, estimates)

    record(feed)
    states = read_texts(file, scene.state_entity("diagnosis"), "StateChange:state")
    assert [state for _, state in states] == ["NOTHING CHANGED", "CHANGED"]
    assert states[1][0] == pytest.approx(1.0)
    texts = [text for _, text in read_texts(file, "/log/diagnosis")]
    assert texts == ["diagnosis: nothing has changed", "diagnosis: axis2: friction 2.04 times"]
    for place, name in (("axis2", "friction"), ("bus", "supply")):
        times, values = read_scalars(file, scene.estimate_entity(place, name, "value"))
        assert times == pytest.approx(0.25 * np.arange(8))
        assert values == pytest.approx(1.0 + 0.1 * np.arange(8))


def test_a_reset_of_the_board_is_logged_and_breaks_the_curves(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        viewer.board(telemetry(move(first=160_000, samples=10, start_ns=START_NS - 10_000_000_000)))
        viewer.board(telemetry(move(first=0, samples=10, start_ns=START_NS + 3_000_000_000)))

    record(feed)
    times, values = read_scalars(file, scene.series_entity(0, "speed", scene.BOARD))
    assert np.all(np.diff(times) > 0.0)
    assert times[-1] == pytest.approx(3.0 + 9 * 0.004, abs=1e-6)
    assert np.isnan(values).sum() == 1
    assert "reset" in read_texts(file, "/log/board")[0][1]


def test_invalid_messages_are_logged_once_and_valid_ones_are_recorded(record: Record, file: Path) -> None:
    def feed(viewer: Viewer) -> None:
        for _ in range(3):
            viewer.board(telemetry(np.zeros((2, 2)), ["time", "axis1.position"]))
        viewer.twin(telemetry(move(samples=10)[:0]))
        viewer.board(telemetry(move(samples=10)))

    record(feed)
    assert len(read_scalars(file, scene.series_entity(1, "i_q", scene.BOARD))[0]) == 10
    assert [text for _, text in read_texts(file, "/log/viewer")] == [
        "viewer: invalid message ignored: telemetry without the column tick"
    ]


class _Stalled:
    """A recording whose first write waits for the test."""

    def __init__(self) -> None:
        self.entered, self.go = threading.Event(), threading.Event()
        self.texts: list[str] = []
        self.closed = False

    def scalars(self, *_: Any) -> None:
        self.entered.set()
        assert self.go.wait(30.0)

    def angles(self, *_: Any) -> None: ...
    def strip(self, *_: Any) -> None: ...
    def state(self, *_: Any) -> None: ...

    def text(self, source: str, moment: float, level: str, text: str) -> None:
        self.texts.append(f"{level} {text}")

    def close(self) -> None:
        self.closed = True


def test_a_stalled_recording_does_not_block_and_losses_are_counted() -> None:
    recording = _Stalled()
    viewer = Viewer(recording, CATALOGUE, START_NS, capacity=10, period=0.01)
    viewer.start()
    rows = move(samples=1)
    viewer.board(telemetry(rows))
    assert recording.entered.wait(10.0)
    begun = time.monotonic()
    for _ in range(25):
        viewer.board(telemetry(rows))
    assert time.monotonic() - begun < 1.0
    assert viewer.dropped == 15
    assert not viewer.close(timeout=0.05)
    recording.go.set()
    assert viewer.close()
    assert recording.closed
    assert "WARN 15 messages dropped: too slow" in recording.texts


def test_a_recording_that_fails_is_reported_and_closed() -> None:
    class Broken(_Stalled):
        def scalars(self, *_: Any) -> None:
            raise OSError("no space left on device")

    recording = Broken()
    viewer = Viewer(recording, CATALOGUE, START_NS, period=0.01)
    viewer.start()
    viewer.board(telemetry(move(samples=1)))
    assert viewer.close()
    assert viewer.failure == "the recording cannot be written: no space left on device"
    assert recording.closed


def test_recording_that_is_not_complete_at_the_end_is_reported() -> None:
    class Full(_Stalled):
        def close(self) -> None:
            raise RecordingError("the recording is not complete: no space left on device")

    recording = Full()
    recording.go.set()
    viewer = Viewer(recording, CATALOGUE, START_NS, period=0.01)
    viewer.start()
    assert viewer.close()
    assert viewer.failure == "the recording is not complete: no space left on device"


def test_full_disk_is_reported(tmp_path: Path) -> None:
    (tmp_path / "run.rrd").symlink_to("/dev/full")
    with pytest.raises(RecordingError, match=r"run\.rrd cannot be written: .*No space left on device"):
        Recording(tmp_path / "run.rrd")


def test_a_file_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"file/run\.rrd cannot be written"):
        Recording(tmp_path / "file" / "run.rrd")


def test_a_file_is_written_by_one_program_at_a_time(file: Path) -> None:
    link = file.with_name("link.rrd")
    link.symlink_to(file)
    first = Recording(file)
    for same in (file, link):
        with pytest.raises(RecordingError, match="is used by another running program; end it, or choose another name"):
            Recording(same)
    first.close()
    Recording(file).close()


def test_a_missing_rerun_is_reported_with_its_remedy(monkeypatch: pytest.MonkeyPatch, file: Path) -> None:
    original = builtins.__import__

    def without_rerun(name: str, *arguments: Any, **options: Any) -> Any:
        if name.split(".")[0] == "rerun":
            raise ImportError("No module named 'rerun'")
        return original(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without_rerun)
    with pytest.raises(RecordingError, match="pip install 'rerun-sdk"):
        Recording(file)


def test_a_file_that_is_no_recording_is_reported(file: Path) -> None:
    file.write_bytes(b"no recording at all" * 20)
    with pytest.raises(RecordingError, match="cannot be read as a recording"):
        read_scalars(file, "/plot")
