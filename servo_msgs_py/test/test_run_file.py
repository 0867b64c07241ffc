"""Recordings: what is written can be read, by this project and by others, however it was cut off."""

from __future__ import annotations

import random
import resource
import shutil
import struct
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from servo_msgs_py.run_file.reader import Record, RunFileError, RunReader
from servo_msgs_py.run_file.run_info import RunInfo, RunInfoError, VirtualBoard, run_info, string_of
from servo_msgs_py.run_file.series import Limits, segment
from servo_msgs_py.run_file.series_writer import SEGMENTS, SeriesWriter
from servo_msgs_py.run_file.topic import Topic
from servo_msgs_py.run_file.writer import RunWriter, UnknownTypeError

STORE = get_typestore(Stores.ROS2_JAZZY)
STATE = Topic("/servo/state", "std_msgs/msg/String", depth=1, latched=True)
RATE = Topic("/servo/var/u_dc", "std_msgs/msg/Float64")
START_NS = 1_700_000_000_000_000_000


def messages(count: int, start: int = 0) -> list[Record]:
    """Messages of two topics, 10 ms apart, with a clock that jumps back once."""
    string, number = STORE.types[STATE.type], STORE.types[RATE.type]
    result = []
    for k in range(start, start + count):
        topic, value = (STATE, string(f"state {k}")) if k % 5 == 0 else (RATE, number(k / 8))
        time_ns = START_NS + k * 10_000_000 - (3_600_000_000_000 if k > 40 else 0)
        result.append(Record(topic.name, topic.type, time_ns, bytes(STORE.serialize_cdr(value, topic.type))))
    return result


def write(path: Path, records: list[Record], per_chunk: int = 10) -> list[int]:
    """Write a recording; returns the size of the file after every chunk."""
    sizes = []
    with RunWriter(path) as writer:
        for k, record in enumerate(records, 1):
            writer.write(STATE if record.topic == STATE.name else RATE, record.data, record.time_ns)
            if k % per_chunk == 0:
                writer.flush()
                sizes.append(writer.size)
    return sizes


def bag(path: Path, records: list[Record], storage: StoragePlugin, compression: CompressionMode | None = None) -> None:
    """Write a bag as others do."""
    writer = BagWriter(path, version=9, storage_plugin=storage)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {t.name: writer.add_connection(t.name, t.type, typestore=STORE) for t in (STATE, RATE)}
        for record in records:
            writer.write(connections[record.topic], record.time_ns, record.data)


def test_what_is_written_is_read_in_the_same_order(tmp_path: Path) -> None:
    path = tmp_path / "new" / "run.mcap"
    write(path, messages(95))
    reader = RunReader(path)
    assert list(reader.records()) == messages(95)
    assert list(reader.records([STATE.name])) == [each for each in messages(95) if each.topic == STATE.name]
    assert reader.troubles == []


def test_other_readers_read_it_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write(path, messages(95))
    expected = sorted(messages(95), key=lambda each: each.time_ns)
    with path.open("rb") as stream:
        found = [
            Record(channel.topic, schema.name, message.log_time, message.data)
            for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
            if schema is not None
        ]
    assert found == expected
    with Reader(path) as reader:
        durabilities = {
            each.topic: each.ext.offered_qos_profiles[0].durability
            for each in reader.connections
            if isinstance(each.ext, ConnectionExtRosbag2)
        }
        texts = [
            getattr(STORE.deserialize_cdr(data, connection.msgtype), "data")  # noqa: B009 (generated types)
            for connection, _, data in reader.messages(reader.connections)
            if connection.topic == STATE.name
        ]
        definition = next(each.msgdef.data for each in reader.connections if each.topic == STATE.name)
    assert durabilities == {STATE.name: QosDurability.TRANSIENT_LOCAL, RATE.name: QosDurability.VOLATILE}
    assert texts == [string_of(each.data) for each in expected if each.topic == STATE.name]
    assert "string data" in definition


def test_padding_of_messages_is_left_out(tmp_path: Path) -> None:
    """A message of zeros stays as it is; readers refuse one that is longer than its members."""
    path, data = tmp_path / "run.mcap", bytes(STORE.serialize_cdr(STORE.types[RATE.type](0.0), RATE.type))
    with RunWriter(path) as writer:
        for padding in (0, 4, 8, 12):
            writer.write(RATE, data + bytes(padding), START_NS)
        writer.write(RATE, b"damaged" + bytes(4), START_NS)
    assert [each.data for each in RunReader(path).records()] == [data] * 4 + [b"damaged" + bytes(4)]


def test_a_file_cut_off_anywhere_is_read_up_to_its_last_flush(tmp_path: Path) -> None:
    whole, part = tmp_path / "run.mcap", tmp_path / "part.mcap"
    sizes = write(whole, messages(90))
    content = whole.read_bytes()
    cuts = random.Random(1).sample(range(sizes[0], sizes[-1]), 100) + sizes
    for cut in cuts:
        part.write_bytes(content[:cut])
        reader = RunReader(part)
        chunks = sum(size <= cut for size in sizes)
        assert list(reader.records()) in (messages(10 * chunks), messages(10 * (chunks + 1)))  # without its index
        assert "not complete" in reader.troubles[-1]


def test_a_damaged_chunk_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sizes = write(path, messages(90))
    content = bytearray(path.read_bytes())
    content[sizes[3] + 100] ^= 0x10
    path.write_bytes(content)
    reader = RunReader(path)
    assert list(reader.records()) == messages(40) + messages(40, 50)
    assert reader.troubles == [f"{path}: 1 damaged chunk left out"]


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_no_record_takes_more_memory_than_the_bound(compression: str, tmp_path: Path) -> None:
    """Of a chunk that is small when packed, states another size than it has, or is large on the disk."""
    path, zeros = tmp_path / "run.mcap", bytes(300_000_000)
    packed = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    for stated, length in ((len(zeros), 0), (1000, 0), (1000, 300_000_000)):
        body = struct.pack("<QQQII", 0, 0, stated, 0, len(compression)) + compression.encode()
        body += struct.pack("<Q", len(packed)) + packed
        path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", Opcode.CHUNK, length or len(body)) + body)
        reader = RunReader(path)
        tracemalloc.start()
        assert list(reader.records()) == []
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
        tracemalloc.stop()
        bound = f"{path} ends at a record of more than 256000000 bytes, the largest size"
        assert reader.troubles[0] == (bound if length else f"{path}: 1 damaged chunk left out")


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """Files do not grow beyond a size [bytes], as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_what_was_complete(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sizes = write(tmp_path / "other.mcap", messages(90))
    with pytest.raises(OSError, match=r"run\.mcap"), disk_of(sizes[3] + 50):
        write(path, messages(90))
    assert path.stat().st_size == sizes[3]
    assert list(RunReader(path).records()) == messages(40)


def test_nothing_is_overwritten_and_a_type_without_definition_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RunWriter(path) as writer, pytest.raises(UnknownTypeError, match="own_msgs/msg/Own"):
        writer.write(Topic("/own", "own_msgs/msg/Own"), b"", 0)
    with pytest.raises(FileExistsError, match=r"run\.mcap"):
        RunWriter(path)


@pytest.mark.parametrize("storage", StoragePlugin)
@pytest.mark.parametrize("compression", [None, CompressionMode.MESSAGE, CompressionMode.FILE])
def test_bags_of_others_are_read(tmp_path: Path, storage: StoragePlugin, compression: CompressionMode | None) -> None:
    expected = messages(60)  # the clock jumps back
    bag(tmp_path / "bag", expected, storage, compression)
    reader = RunReader(tmp_path / "bag")
    assert list(reader.records()) == expected
    assert list(reader.records([RATE.name])) == [each for each in expected if each.topic == RATE.name]
    assert not [*reader.records(["/other"]), *reader.troubles]
    if compression is None:
        (tmp_path / "bag" / "metadata.yaml").unlink()  # its recorder was killed
        assert list(RunReader(tmp_path / "bag").records()) == expected


@pytest.mark.parametrize("storage", StoragePlugin)
@pytest.mark.parametrize("compression", [None, CompressionMode.MESSAGE, CompressionMode.FILE])
def test_damaged_bags_of_others_are_read_or_refused(
    tmp_path: Path, storage: StoragePlugin, compression: CompressionMode | None
) -> None:
    """Cut off or changed anywhere, with and without metadata: messages, what is missing, or one error."""
    bag(tmp_path / "bag", messages(90), storage, compression)
    (path,) = (file for file in (tmp_path / "bag").iterdir() if file.suffix != ".yaml")
    content, chance = path.read_bytes(), random.Random(1)
    for number in range(60):
        if number == 30:
            (tmp_path / "bag" / "metadata.yaml").unlink()
        damaged = bytearray(content[: chance.randrange(len(content)) if number % 3 else None])
        for _ in range(chance.randrange(1, 30) if damaged and number % 2 else 0):
            damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
        path.write_bytes(damaged)
        try:
            reader = RunReader(tmp_path / "bag")
            found = list(reader.records())
        except RunFileError as error:
            assert str(path) in str(error)  # noqa: PT017
        else:
            assert len(found) <= 90
            only_cut = number % 3 and not number % 2
            assert reader.troubles or len(found) == 90 or not only_cut


def test_an_sqlite_bag_that_was_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    bag(tmp_path / "bag", messages(2000), StoragePlugin.SQLITE3)
    path = tmp_path / "bag" / "bag.db3"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    reader = RunReader(path)
    found = list(reader.records())
    assert len(found) > 500
    assert found == messages(len(found))
    assert reader.troubles == [f"{path} is damaged, what is before is read: database disk image is malformed"]


def test_segments_are_one_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for number in range(12):
        write(segment(path, number), messages(3, 3 * number))
    write(tmp_path / "run_2024.mcap", messages(5))
    reader = RunReader(path)
    assert list(reader.records()) == messages(36)
    assert reader.troubles == [f"{tmp_path}/run_2024.mcap does not continue {tmp_path}/run_11.mcap and is left out"]
    path.unlink()
    segment(path, 1).unlink()
    assert list(RunReader(path).records()) == messages(30, 6)
    assert list(RunReader(segment(path, 7)).records()) == messages(3, 21)


def series(path: Path, limits: Limits, count: int, free: int = 10**12) -> None:
    """Record messages 10 ms apart, flushed every 0.1 s."""
    writer = SeriesWriter(path, limits, lambda _: free)
    try:
        for k, record in enumerate(messages(count)):
            writer.write(STATE if record.topic == STATE.name else RATE, record.data, record.time_ns)
            if k % 10 == 9:
                writer.flush(k * 0.01, record.time_ns)
    finally:
        writer.close()


def test_the_oldest_segments_go_at_the_size_limit(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    series(path, Limits(size=40_000), 2000)
    assert 30_000 < sum(file.stat().st_size for file in tmp_path.iterdir()) < 40_000
    assert not path.exists()
    records = list(RunReader(path).records())
    assert records[0].topic == STATE.name  # the last message before the segment
    kept = [each for each in records if each.topic == RATE.name]
    assert kept == [each for each in messages(2000) if each.topic == RATE.name][-len(kept) :]


def test_the_oldest_segments_go_at_the_time_limit(tmp_path: Path) -> None:
    series(tmp_path / "run.mcap", Limits(duration=2.0), 2000)
    kept = sum(each.topic == RATE.name for each in RunReader(tmp_path / "run.mcap").records()) * 10e-3 / 0.8
    assert 2.0 <= kept <= 2.0 * (1 + 2 / SEGMENTS)


def test_a_recording_ends_complete_before_the_disk_is_full(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with pytest.raises(OSError, match=r"MB are free: '.*run\.mcap'"):
        series(path, Limits(), 40, free=10_000)
    reader = RunReader(path)
    assert list(reader.records()) == messages(10)
    assert reader.troubles == []
    with pytest.raises(FileExistsError, match=r"run\.mcap"):
        SeriesWriter(path)


def test_files_that_the_metadata_lists_are_read_in_its_order(tmp_path: Path) -> None:
    for name, start in (("b", 0), ("a", 40)):
        write(tmp_path / f"{name}.mcap", messages(40, start))
    listed = "relative_file_paths: [b.mcap, a.mcap, c.mcap]"
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  {listed}\n")
    reader = RunReader(tmp_path)
    assert list(reader.records()) == messages(80)
    assert reader.troubles == [f"{tmp_path}/c.mcap, which metadata.yaml lists, is missing"]


def test_lost_messages_are_said(tmp_path: Path) -> None:
    path, lost = tmp_path / "run.mcap", Topic("/servo/run_lost", "std_msgs/msg/UInt64")
    with RunWriter(path) as writer:
        for count in (3, 700):
            data = STORE.serialize_cdr(STORE.types[lost.type](count), lost.type)
            writer.write(lost, bytes(data), START_NS)
    reader = RunReader(path)
    assert list(reader.records([STATE.name])) == []
    assert reader.troubles == ["the recorder has lost 700 messages because the computer was too slow"]
    assert [each.topic for each in reader.records()] == [lost.name] * 2


def test_other_encodings_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/json", "json", 0), 1, b"{}", 1)
        writer.finish()
    reader = RunReader(path)
    assert list(reader.records()) == []
    assert reader.troubles == [f"{path}: /json is not read, its encoding is not cdr"]


def test_what_cannot_be_read_is_refused_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("no recording, but long enough to have a head")
    (tmp_path / "text.db3").write_text("no recording")
    for name, text in {
        "none.mcap": "no such recording; give",
        "run.bag": "rosbags-convert",
        "run.csv": "give a .mcap",
        "text.mcap": "is no MCAP file; give",
        "text.db3": "text.db3 is no bag that can be read: file is not a database; give",
        ".": "several recordings; give one: text.db3, text.mcap",
    }.items():
        with pytest.raises(RunFileError, match=text):
            list(RunReader(tmp_path / name).records())
    shutil.rmtree(tmp_path)
    tmp_path.mkdir()
    with pytest.raises(RunFileError, match="contains no recording"):
        RunReader(tmp_path)


def test_run_info_is_read_as_written() -> None:
    board = VirtualBoard(level="ideal", seed=3, plant="[axis1]", faults=("phase open",))
    info = RunInfo(software="0.1.0", parameters={"param.host_timeout": [5]}, configuration=({"pole_pairs": 4},))
    for each in (info, replace(info, virtual_board=board)):
        assert run_info(each.text()).text() == each.text()
    assert run_info('{"format":1,"later":true}') == RunInfo()
    for text, problem in (("{", "damaged"), ("[]", "damaged"), ("{}", "damaged"), ('{"format":2}', "newer version")):
        with pytest.raises(RunInfoError, match=problem):
            run_info(text)
    for data in (b"", b"\0\1\0\0\5", b"\0\1\0\0\3\0\0\0\xff\xff\0"):
        with pytest.raises(RunInfoError, match="no string"):
            string_of(data)
