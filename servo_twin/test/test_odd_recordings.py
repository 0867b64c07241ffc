"""Recordings as others make them: a correct result, or one clear error; never a traceback or a wrong verdict."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from servo_msgs_py.convert import snapshot_message, snapshot_table
from servo_msgs_py.run_file.definitions import decoded, encoded
from servo_msgs_py.run_file.reader import Record, RunReader
from servo_msgs_py.run_file.run_info import string_of
from servo_twin.board import Board
from servo_twin.diagnosis.board_pair import Motion
from servo_twin.runs.command import main
from servo_twin.runs.sample_order import Place, SampleOrder
from servo_twin.validation.simulated_run import SimulatedRun
from std_msgs.msg import Float64MultiArray, String

SEED: Final = 7
SNAPSHOT: Final = "/servo/snapshot"
ROWS: Final = 4  # samples of a message, as the bridge publishes them

Table = NDArray[np.float64]
Records = list[Record]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Records]:
    """A recording and its messages, the samples in messages of `ROWS`."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    with SimulatedRun(path, Board(seed=SEED, level="ideal"), seed=SEED) as simulated:
        simulated.enable()
        list(Motion(simulated, SEED).run(1.0))
    records, waiting = [], []
    for record in RunReader(path).records():
        if record.topic == SNAPSHOT:
            waiting.append(record)
        if record.topic != SNAPSHOT or len(waiting) == ROWS:
            records += joined(waiting)
            waiting = []
        if record.topic != SNAPSHOT:
            records.append(record)
    return path, records + joined(waiting)


def joined(waiting: Records) -> Records:
    if not waiting:
        return []
    tables = [snapshot_table(decoded(record.data, record.type)) for record in waiting]
    rows = np.vstack([table for _, table in tables]).tolist()
    return [waiting[-1]._replace(data=encoded(snapshot_message(tables[0][0], rows)))]


def bag(folder: Path, records: Sequence[Record], storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    store, path = get_typestore(Stores.ROS2_JAZZY), folder / "bag"
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connections: dict[tuple[str, str], Any] = {}
        for record in records:
            key = record.topic, record.type
            if key not in connections:
                connections[key] = writer.add_connection(*key, typestore=store)
            writer.write(connections[key], record.time_ns, record.data)
    return path


def changed(records: Records, change: Callable[[list[str], Table], tuple[list[str], Table]]) -> Records:
    """The recording with another table in the middle message of the samples."""
    places = [place for place, record in enumerate(records) if record.topic == SNAPSHOT]
    middle = places[len(places) // 2]
    names, table = snapshot_table(decoded(records[middle].data, SNAPSHOT_TYPE))
    names, table = change(list(names), table.copy())
    data = encoded(snapshot_message(names, table.tolist()))
    return [*records[:middle], records[middle]._replace(data=data), *records[middle + 1 :]]


SNAPSHOT_TYPE: Final = "std_msgs/msg/Float64MultiArray"


def valued(column: str, value: float) -> Callable[[list[str], Table], tuple[list[str], Table]]:
    def change(names: list[str], table: Table) -> tuple[list[str], Table]:
        table[0, names.index(column)] = value
        return names, table

    return change


def replayed(path: Path, capsys: pytest.CaptureFixture[str], status: int = 0) -> Any:
    assert main(["replay", str(path), "--json"]) == status
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e300])
@pytest.mark.parametrize("column", ["tick", "u_dc", "axis1.speed", "axis2.state"])
def test_numbers_that_no_board_sends_are_left_out_of_a_replay(
    run: tuple[Path, Records], tmp_path: Path, capsys: pytest.CaptureFixture[str], column: str, value: float
) -> None:
    path = bag(tmp_path, changed(run[1], valued(column, value)))
    result = replayed(path, capsys)
    assert result["verdict"].startswith("identical bit for bit over")
    assert f" of {result['compared']['samples'] + ROWS} samples" in result["verdict"]
    assert any(f"a sample has the {column} " in note for note in result["notes"])
    assert main(["export", str(path), "-o", str(tmp_path / "tables")]) == 0
    if not np.isfinite(value):
        assert main(["compare", str(run[0]), str(path)]) == 2
        assert "leave such samples out" in capsys.readouterr().err


def twice(records: Records) -> Records:
    return [record for record in records for _ in range(2)]


def swapped(records: Records) -> Records:
    """With two messages of samples in every eight swapped."""
    result, places = list(records), [place for place, record in enumerate(records) if record.topic == SNAPSHOT]
    for first, second in zip(places[3::8], places[4::8], strict=False):
        result[first], result[second] = result[second], result[first]
    return result


def all_swapped(records: Records) -> Records:
    pairs = zip(records[1::2], records[::2], strict=False)
    return [record for pair in pairs for record in pair]


def shuffled(records: Records) -> Records:
    return random.Random(SEED).sample(records, len(records))


def commands_behind(records: Records) -> Records:
    """With every command a few messages later."""
    result: Records = []
    waiting: list[tuple[int, Record]] = []
    for place, record in enumerate(records):
        result += [command for due, command in waiting if due == place]
        if record.topic.endswith("/commands_applied"):
            waiting.append((place + 5, record))
        else:
            result.append(record)
    return result


def again_from_the_middle(records: Records) -> Records:
    return records + records[len(records) // 2 :]


@pytest.mark.parametrize("order", [twice, swapped, all_swapped, shuffled, commands_behind, again_from_the_middle])
def test_messages_out_of_order_are_no_reset_of_the_board(
    run: tuple[Path, Records],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    order: Callable[[Records], Records],
) -> None:
    path = bag(tmp_path, order(run[1]))
    result = replayed(path, capsys)
    assert result["verdict"].startswith("identical bit for bit over")
    assert " of " not in result["verdict"]
    assert not any("reset" in note for note in result["notes"])
    repeats = order in (twice, again_from_the_middle)
    assert any("out of order or repeated" in note for note in result["notes"]) == repeats
    assert main(["compare", str(run[0]), str(path)]) == 0
    capsys.readouterr()
    assert main(["export", str(path), "-o", str(tmp_path / "tables")]) == 0
    assert not (tmp_path / "tables" / "servo.snapshot.2.csv").exists()


@pytest.mark.parametrize("storage", StoragePlugin)
@pytest.mark.parametrize("jump", [-0.1, -1.0, 3600.0])
def test_a_clock_that_jumps_changes_nothing(
    run: tuple[Path, Records], tmp_path: Path, capsys: pytest.CaptureFixture[str], storage: StoragePlugin, jump: float
) -> None:
    middle = len(run[1]) // 2
    later = [record._replace(time_ns=record.time_ns + round(jump * 1e9)) for record in run[1][middle:]]
    path = bag(tmp_path, [*run[1][:middle], *later], storage)
    result = replayed(path, capsys)
    assert result["verdict"].startswith("identical bit for bit over")
    assert " of " not in result["verdict"]
    assert main(["compare", str(run[0]), str(path)]) == 0


def test_a_reset_is_found_also_when_the_clock_jumps() -> None:
    day = 86_400_000_000_000
    for jump in (0, day, -day):
        order = SampleOrder()
        assert order.place(160_000, 160_800, 10_000_000_000) is Place.NEXT
        assert order.place(800, 1_600, 10_500_000_000 + jump) is Place.RESET
        assert order.place(2_400, 3_200, 10_600_000_000 + jump) is Place.NEXT
        assert order.place(800, 1_600, 10_500_000_000 + jump) is Place.LATE
        assert order.newest == 3_200


def test_the_parts_of_a_reset_recording_can_be_compared(
    run: tuple[Path, Records], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    later = [record._replace(time_ns=record.time_ns + 60_000_000_000) for record in run[1]]
    path = bag(tmp_path, [*run[1], *later])
    assert replayed(path, capsys)["identical"]
    assert main(["compare", str(run[0]), str(path)]) == 2
    assert "the board was reset before 0.0" in capsys.readouterr().err
    assert main(["export", str(path), "-o", str(tmp_path), "--topic", SNAPSHOT]) == 0
    assert main(["compare", *(str(tmp_path / f"servo.snapshot{number}.csv") for number in ("", ".2"))]) == 0


def without_rows(names: list[str], table: Table) -> tuple[list[str], Table]:
    return names, table[:0]


def column_twice(names: list[str], table: Table) -> tuple[list[str], Table]:
    return [*names, names[5]], np.hstack([table, table[:, :1]])


@pytest.mark.parametrize("change", [without_rows, column_twice])
def test_tables_without_rows_or_with_a_column_twice(
    run: tuple[Path, Records],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[list[str], Table], tuple[list[str], Table]],
) -> None:
    path = bag(tmp_path, changed(run[1], change))
    assert replayed(path, capsys)["identical"]
    assert main(["compare", str(run[0]), str(path)]) == (0 if change is without_rows else 2)
    assert main(["export", str(path), "-o", str(tmp_path / "tables")]) == 0


def test_empty_arrays_of_others_are_no_tables(
    run: tuple[Path, Records], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = Record("/other/array", SNAPSHOT_TYPE, run[1][0].time_ns, encoded(Float64MultiArray()))
    path = bag(tmp_path, [*run[1], empty, *(empty._replace(topic=f"/日本/ü{k}") for k in range(10))])
    assert replayed(path, capsys)["identical"]
    assert main(["export", str(path), "-o", str(tmp_path / "tables")]) == 0


@pytest.mark.parametrize(
    ("member", "value"),
    [("seed", "x"), ("plant", 5), ("build", 5), ("faults", 5), ("robot", 5), ("level", []), ("speed", "1")],
)
def test_a_damaged_run_info_is_said(
    run: tuple[Path, Records], tmp_path: Path, capsys: pytest.CaptureFixture[str], member: str, value: object
) -> None:
    result = replayed(bag(tmp_path, informed(run[1], {member: value})), capsys)
    assert any("the run info is damaged" in note and repr(value) in note for note in result["notes"])


def test_a_damaged_plant_can_be_replaced(
    run: tuple[Path, Records], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bag(tmp_path, informed(run[1], {"plant": "[axis1]\nfriction = 1\n"}, catalogue="none", tick_ns=50_000))
    assert main(["replay", str(path)]) == 2
    assert "the plant in the recording is damaged (axis1: r_s is missing); --plant" in capsys.readouterr().err
    plant = tmp_path / "plant.toml"
    plant.write_text("")
    assert main(["replay", str(path), "--plant", str(plant)]) == 0
    text = capsys.readouterr().out
    assert "another table of variables (none instead of" in text
    assert "ticks of 50000 ns instead of 62500 ns" in text


def informed(records: Records, virtual: dict[str, object], **members: object) -> Records:
    """The recording with other members of its run info and of its virtual board."""

    def change(record: Record) -> Record:
        if not record.topic.endswith("/run_info"):
            return record
        document = json.loads(string_of(record.data))
        document["virtual_board"] |= virtual
        return record._replace(data=encoded(String(data=json.dumps(document | members))))

    return list(map(change, records))
