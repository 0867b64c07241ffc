"""Recorders: byte examples of the protocol, triggers, and random exchanges against the model."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from freemaster_board import Board
from freemaster_model import (
    ENTRIES,
    LIVE_SIZE,
    MEMORY_SIZE,
    SAMPLES,
    SERVO,
    Answer,
    Layout,
    examples,
    initial_memory,
    sleb,
    uleb,
)
from freemaster_recorder import (
    ABOVE,
    BELOW,
    LEVEL,
    NOT_STORED,
    SIGNED,
    START,
    STOP,
    UNSIGNED,
    VARIABLE,
    Memory,
    Recorder,
    memory,
    operation,
    variable,
)
from hypothesis import given
from hypothesis import strategies as st

READ, SET, GET = 0x21, 0x24, 0x25
DESCRIPTION, LIMITS, INFO, STATUS = 0x81, 0x82, 0x83, 0x84

WORD0, WORD1, LONG = SERVO.variables + 0x54, SERVO.variables + 0x56, SERVO.variables + 0xBC


def configure(board: Board, *operations: bytes, recorder: int = 0) -> int:
    """SETREC; returns its status."""
    return board.ask(SET, bytes([recorder]) + b"".join(operations)).status


def query(board: Board, code: int, recorder: int = 0) -> bytes:
    """GETREC."""
    answer = board.ask(GET, bytes([recorder, code]))
    assert answer.status == 0x40
    return answer.data


def status(board: Board) -> int:
    """State of the first recorder."""
    return query(board, STATUS)[0]


def points(board: Board, layout: str) -> list[tuple[int, ...]]:
    """Points of the first recorder in the order of time."""
    reader = query(board, INFO)[2:]
    numbers = []
    while reader:
        end = next(k for k, byte in enumerate(reader) if byte < 0x80) + 1
        numbers.append(sum((byte & 0x7F) << 7 * k for k, byte in enumerate(reader[:end])))
        reader = reader[end:]
    address, size, count, first = numbers
    assert size == struct.calcsize(layout)
    data = board.ask(READ, uleb(address) + uleb(size * count)).data
    found = [struct.unpack_from(layout, data, size * k) for k in range(count)]
    return found[first:] + found[:first]


def run(board: Board, values: list[int], offset: int = 0xBC) -> None:
    """One sample of the first recorder for each value of an int32 variable."""
    for value in values:
        board.poke(offset, struct.pack("<i", value))
        board.sample(0)


# ---- examples of the protocol ----------------------------------------------------------------------------------------


def test_two_slots_of_the_byte_examples(sheet: Board) -> None:
    def ask(text: str) -> str:
        return sheet.send(bytes.fromhex(text)).hex(" ").upper()

    assert ask("2B 24 07 00 01 04 02 14 05 00 55") == "2B 00 00"
    assert ask("2B 24 0C 00 02 09 00 B8 80 80 80 02 04 00 00 9C") == "2B 00 00"
    assert ask("2B 24 0D 00 02 0A 01 BC 80 80 80 02 02 12 9C 7F F5") == "2B 00 00"
    assert ask("2B 24 03 00 03 00 EE") == "2B 00 00"
    assert ask("2B 25 02 00 84 C3") == "2B 40 01 02 9D"
    for value, times in (
        (-101, 19),
        (-100, 2),
        (-101, 12),
        (-100, 40),
    ):  # no edge in the first sample
        assert status(sheet) == 2
        sheet.poke(0x3C, struct.pack("<h", value))
        sheet.sample(0, times)
    # 33 points, the trigger, and 14 after it: 48 in total; the oldest is at 8 of 20.
    assert query(sheet, INFO) == bytes.fromhex("04 02 80 C1 80 80 02 06 14 08")
    assert [word for _, word in points(sheet, "<Ih")] == [-101] * 5 + [-100] * 15


def test_trigger_examples_of_the_protocol(sheet: Board) -> None:
    """A float is refused; a signed edge below the variable at 0x66."""
    all_in_one = (
        "2B 24 23 00 01 04 02 08 03 00 02 09 00 B8 80 80 80 02 04 00 00 02 0D 01 EC 80 80 80 02 04 17 80 80 A2 96 04"
    )
    assert sheet.send(bytes.fromhex(all_in_one + "03 00 F6")) == bytes.fromhex("2B 90 F9")
    assert query(sheet, STATUS) == b"\x00"
    below = "2B 24 18 00 01 04 01 08 03 00 02 0D 00 BC 80 80 80 02 02 A2 E6 80 80 80 02 03 00 9C"
    assert sheet.send(bytes.fromhex(below)) == bytes.fromhex("2B 00 00")
    sheet.poke(0x66, struct.pack("<h", -7))
    for value in (*range(-4, 4), 3, 2, -6, -8, -9, -10, -11, -12):
        sheet.poke(0x3C, struct.pack("<h", value))
        sheet.sample(0)
    assert [value for (value,) in points(sheet, "<h")] == [3, 2, -6, -8, -9, -10, -11, -12]


def test_properties_of_the_recorders(servo: Board) -> None:
    assert [query(servo, DESCRIPTION, k) for k in range(2)] == [b"fast", b"slow"]
    assert query(servo, LIMITS, 0) == uleb(SAMPLES) + uleb(1_000_000) + b"\0\0"
    assert query(servo, LIMITS, 1) == uleb(SAMPLES) + b"\0\0\0"
    assert query(servo, INFO) == bytes(6)


@pytest.mark.parametrize(
    ("mode", "threshold", "first"),
    [
        (SIGNED | ABOVE, sleb(3), 28),
        (SIGNED | BELOW, sleb(3), 20),
        (SIGNED | ABOVE | BELOW, sleb(3), 20),
        (SIGNED | ABOVE | LEVEL, sleb(3), 10),
        (SIGNED | BELOW | LEVEL, sleb(3), 20),
        (UNSIGNED | ABOVE, uleb(0x8000_0000), 20),  # -5 is a large number
        (UNSIGNED | BELOW, uleb(0x8000_0000), 25),
        (SIGNED | ABOVE, sleb(15), None),
        (SIGNED, sleb(3), None),
        (ABOVE | LEVEL, sleb(3), None),
    ],
)
def test_a_trigger_fires_at_the_crossing_that_its_mode_selects(
    servo: Board, mode: int, threshold: bytes, first: int | None
) -> None:
    """A repeated ramp from -5 to 14; a trigger may fire from the tenth point, when the memory is full."""
    ramp = [k % 20 - 5 for k in range(60)]
    assert configure(servo, memory(1, 10, 4), variable(0, LONG, 4, mode, threshold), START) == 0
    run(servo, ramp)
    assert status(servo) == (2 if first is None else 4)
    if first is not None:
        assert points(servo, "<i") == [(value,) for value in ramp[first - 4 : first + 6]]


def test_a_variable_with_a_source_is_recorded_from_there(servo: Board) -> None:
    """A recorder reads the original of the loops, not its copy; a separate region has no copy."""
    live = SERVO.live
    slots = [variable(0, WORD0, 2), variable(1, WORD1, 2), variable(2, live, 2), variable(3, live + 4, 4)]
    servo.poke(0x54, b"\x11\x11\x22\x22")
    servo.poke_live(2, b"\x33\x33")
    servo.poke_live(6, b"\x44\x44")
    servo.poke_live(12, b"\x55\x66\x77\x08")
    assert configure(servo, memory(4, 3), *slots, START) == 0
    servo.sample(0)
    assert configure(servo, STOP) == 0
    assert points(servo, "<HHHI") == [(0x3333, 0x2222, 0x4444, 0x08776655)]
    assert servo.ask(READ, uleb(WORD0) + b"\x02") == Answer(0, b"\x11\x11")
    assert servo.ask(READ, uleb(live + 4) + b"\x04") == Answer(0, b"\x55\x66\x77\x08")
    assert servo.ask(READ, uleb(live + 8) + b"\x04") == Answer(0x89), "invalid table: the source is beyond the memory"
    assert servo.ask(0x23, b"\0" + uleb(live) + b"\x02\0\0") == Answer(0x89)


def test_divider_applies_and_a_partly_filled_memory_is_read(servo: Board) -> None:
    assert configure(servo, memory(1, 5, 0, 2), variable(0, LONG, 4), START) == 0
    run(servo, list(range(10)))
    assert configure(servo, STOP) == 0
    assert status(servo) == 3
    assert points(servo, "<i") == [(0,), (3,), (6,), (9,)]
    assert configure(servo, START) == 0, "repeated with the same setup"
    run(servo, [100])
    assert configure(servo, STOP, START, STOP) == 0
    assert points(servo, "<i") == []


def test_samples_are_readable_after_the_recording(servo: Board) -> None:
    """Samples cannot be read before the first configuration, beyond the memory, and while recording."""
    begin = uleb(SERVO.samples)
    assert servo.ask(READ, begin + b"\x04") == Answer(0x89)
    assert configure(servo, memory(1)) == 0
    assert servo.ask(READ, begin + b"\x04").status == 0
    assert servo.ask(READ, uleb(SERVO.samples + SAMPLES - 4) + b"\x04").status == 0
    assert servo.ask(READ, uleb(SERVO.samples + SAMPLES - 4) + b"\x05") == Answer(0x89)
    assert servo.ask(0x23, b"\0" + begin + b"\x02\0\0") == Answer(0x89)
    assert servo.read(SERVO.samples, 4)[0] == 0
    assert configure(servo, variable(0, LONG, 4), START) == 0
    assert servo.ask(READ, begin + b"\x04") == Answer(0x89)
    assert servo.read(SERVO.samples, 4)[0] == 0x89
    assert configure(servo, variable(0, SERVO.samples, 4)) == 0x87
    assert configure(servo, memory(1), variable(0, SERVO.samples, 4)) == 0x89, (
        "the memory of a recorder cannot be recorded"
    )


def test_recorders_share_their_memory(servo: Board) -> None:
    """One recorder at a time; the samples belong to the recorder configured last."""
    assert configure(servo, memory(1), variable(0, LONG, 4), START) == 0
    assert configure(servo, memory(1), recorder=1) == 0x87
    assert configure(servo, STOP) == 0
    assert configure(servo, memory(9), recorder=1) == 0x86
    assert status(servo) == 3, "a refused request does not discard the samples"
    assert configure(servo, memory(1), variable(0, WORD1, 2), START, recorder=1) == 0
    assert status(servo) == 0
    assert configure(servo, START) == 0x86
    assert query(servo, INFO, 1) == b"\x02\x01" + b"".join(map(uleb, (SERVO.samples, 2, 0, 0)))
    assert configure(servo, memory(1)) == 0x87


def test_a_start_keeps_the_side_of_the_last_sample(servo: Board) -> None:
    """With a memory of one point the second sample may fire if the first was on the other side of the threshold."""
    assert configure(servo, memory(1, 1), variable(0, LONG, 4, SIGNED | ABOVE, sleb(3)), START) == 0
    run(servo, [2, 5])
    assert status(servo) == 4
    assert configure(servo, START) == 0
    run(servo, [6, 7])
    assert status(servo) == 2


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (b"", 0x86),
        (b"\x02", 0x94),
        (b"\x02\x03\x00", 0x94),
        (b"\x00", 0),
        (b"\x00\x03", 0),  # a single extra byte
        (b"\x00\x05\x00", 0x95),
        (b"\x00\x03\x01", 0x86),  # operand beyond the payload
        (b"\x00\x03\x01\x00", 0x86),  # operand of an operation that has none
        (b"\x00" + START, 0x86),
        (b"\x00" + STOP, 0x88),
        (b"\x00" + memory(8), 0),
        (b"\x00" + memory(9), 0x86),  # the vendor's server writes beyond its memory
        (b"\x00" + memory(255), 0x86),
        (b"\x00" + operation(1, b"\x01\x00\x00"), 0x86),
        (b"\x00" + operation(1, b"\x01\x00\x00\x00\x00"), 0x86),
        (b"\x00" + variable(0, LONG, 4), 0x94),  # no slots
        (b"\x00" + memory(1) + variable(1, LONG, 4), 0x94),
        (b"\x00" + memory(1) + variable(0, LONG, 3), 0x86),
        (b"\x00" + memory(1) + variable(0, LONG, 4, threshold=b""), 0x86),
        (b"\x00" + memory(1) + variable(0, LONG, 4, threshold=b"\0\0"), 0x86),
        (b"\x00" + memory(1) + variable(0, LONG + 2, 4), 0x89),
        (b"\x00" + memory(1) + variable(0, LONG, 4, UNSIGNED | ABOVE | VARIABLE, uleb(LONG + 1)), 0x89),
        (b"\x00" + memory(1) + variable(0, LONG, 4, 3), 0x90),
        (b"\x00" + memory(1) + variable(0, WORD1, 2, 3), 0x86),
        (b"\x00" + memory(1) + variable(0, LONG, 4) + STOP, 0x88),  # complete, but not checked yet
        (b"\x00" + memory(1) + variable(0, LONG, 4) + START + variable(0, LONG, 4), 0x87),
        (b"\x00" + memory(1) + variable(0, LONG, 4) + START + START + STOP + STOP, 0),
        (b"\x00" + memory(1) + variable(0, LONG, 4, NOT_STORED) + START, 0x86),
        (b"\x00" + memory(2) + variable(0, LONG, 4) + START, 0x86),
    ],
)
def test_a_wrong_operation_gets_its_own_status(servo: Board, payload: bytes, expected: int) -> None:
    assert servo.ask(SET, payload) == Answer(expected)


@pytest.mark.parametrize(
    ("payload", "expected"),
    [(b"", 0x86), (b"\x00", 0x86), (b"\x02\x84", 0x94), (b"\x02", 0x94), (b"\x00\x80", 0x95), (b"\x00\x85", 0x95)],
)
def test_a_wrong_query_is_refused(servo: Board, payload: bytes, expected: int) -> None:
    assert servo.ask(GET, payload) == Answer(expected)


def test_a_query_completes_the_configuration(servo: Board) -> None:
    assert configure(servo, memory(1, 300, 400), variable(0, LONG, 4)) == 0
    assert status(servo) == 1
    assert query(servo, INFO) == b"\x01\x01" + b"".join(map(uleb, (SERVO.samples, 4, 256, 0))), (
        "the number of points that fit"
    )
    assert configure(servo, variable(0, LONG, 4)) == 0x87
    assert configure(servo, START, memory(1, 20)) == 0, "also while recording"
    assert query(servo, INFO) == bytes(6)


# ---- against the model ---------------------------------------------------------------------------------------------

RECORDABLE = [
    entry for entry in ENTRIES if not entry.absolute and entry.size and SERVO.recordable(SERVO.address(entry), 1)
]
ADDRESS = st.one_of(
    st.builds(
        lambda entry, shift: SERVO.address(entry) + shift,
        st.sampled_from(RECORDABLE),
        st.sampled_from([0] * 6 + [1, 2]),
    ),
    st.sampled_from([0, 2**32 - 1, SERVO.strings, SERVO.table, SERVO.samples, SERVO.live + LIVE_SIZE]),
)
MODE = st.one_of(
    st.just(0),
    st.builds(
        lambda kind, flags: kind | sum(flags),
        st.sampled_from([UNSIGNED, SIGNED, SIGNED]),
        st.sets(st.sampled_from([ABOVE, BELOW, LEVEL, VARIABLE, NOT_STORED])),
    ),
    st.integers(0, 255),
)
THRESHOLD = st.one_of(
    st.integers(-300, 300).map(sleb), st.integers(0, 2**33).map(uleb), ADDRESS.map(uleb), st.binary(max_size=3)
)
SIZE = st.sampled_from([1, 2, 2, 4, 4, 8, 3])
COUNT = st.one_of(st.integers(0, 20), st.sampled_from([0, 2**31, 2**32 - 1]))
OPERATION = st.one_of(
    st.builds(memory, st.integers(0, 3), COUNT, COUNT, st.integers(0, 2)),
    st.builds(memory, st.integers(0, 9)),
    st.builds(variable, st.integers(0, 2), ADDRESS, SIZE, MODE, THRESHOLD),
    st.just(START),
    st.just(STOP),
    st.builds(operation, st.integers(0, 5), st.binary(max_size=8)),
)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("set"), st.integers(0, 1), st.lists(OPERATION, max_size=4).map(b"".join)),
        st.tuples(st.just("get"), st.integers(0, 1), st.sampled_from([INFO, STATUS])),
        st.tuples(st.just("read"), st.integers(0, SAMPLES + 4), st.integers(0, 40)),
        st.tuples(st.just("run"), st.integers(0, 1), st.integers(0, 2**32)),
    ),
    min_size=4,
    max_size=30,
)
BEGIN = st.builds(
    lambda slots, total, before: [("set", 0, memory(len(slots), total, before)), *slots, ("set", 0, START)],
    st.lists(
        st.builds(
            lambda entry, mode, threshold: (entry, mode, threshold),
            st.sampled_from([entry for entry in RECORDABLE if entry.size in (1, 2, 4, 8)]),
            MODE.filter(lambda mode: mode & 3 != 3 and not mode & VARIABLE),
            st.integers(-300, 300),
        ),
        min_size=1,
        max_size=8,
    ).map(
        lambda found: [
            (
                "set",
                0,
                variable(
                    k,
                    SERVO.address(entry),
                    entry.size,
                    mode,
                    sleb(threshold) if mode & 3 == SIGNED else uleb(abs(threshold)),
                ),
            )
            for k, (entry, mode, threshold) in enumerate(found)
        ]
    ),
    st.integers(0, 12),
    st.integers(0, 12),
)


@given(begin=BEGIN, steps=STEPS)
@examples(300)
def test_board_and_model_answer_alike_to_random_requests(
    new_board: Callable[[Layout], Board], begin: list[tuple[str, int, bytes]], steps: list[tuple[str, int, bytes | int]]
) -> None:
    """Board and model receive the same requests and have the same memory; every answer is the same."""
    board = new_board(SERVO)
    held = Memory(SERVO, bytearray(initial_memory()), bytearray(LIVE_SIZE))
    recorders = [Recorder(k, held) for k in range(2)]
    for what, which, value in [*begin, ("run", 0, 5), *steps, ("get", 0, INFO), ("get", 1, INFO), ("read", 0, 200)]:
        if what == "set":
            assert isinstance(value, bytes)
            assert board.ask(SET, bytes([which]) + value) == recorders[which].set(value)
        elif what == "get":
            assert isinstance(value, int)
            assert board.ask(GET, bytes([which, value])) == recorders[which].get(value)
        elif what == "read":
            assert isinstance(value, int)
            expected = held.recorded(SERVO.samples + which, value)
            assert board.ask(READ, uleb(SERVO.samples + which) + uleb(value)) == (
                Answer(0x89) if expected is None else Answer(0, expected)
            )
        else:
            assert isinstance(value, int)
            _let_run(board, held, recorders[which], value)
    assert board.violations() == 0


def _let_run(board: Board, held: Memory, recorder: Recorder, seed: int) -> None:
    """Run the loop while the variables change slowly and quickly."""
    for k in range(seed % 37):
        for size, target, poke in ((MEMORY_SIZE, held.variables, board.poke), (LIVE_SIZE, held.live, board.poke_live)):
            place = (seed // (k + 1)) % (size - 2)
            target[place : place + 2] = struct.pack("<h", (k * 29 + seed) % 600 - 300)
            poke(place, bytes(target[place : place + 2]))
        board.sample(recorder.index)
        recorder.sample()
