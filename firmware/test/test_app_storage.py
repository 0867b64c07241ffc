"""Parameters and configuration in the data flash: complete sets only, at any power failure."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pytest
from block_bench import BlockBench
from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from servo_bench import STATE
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block, send_block, take_blocks
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.board_storage import stored_layout
from servo_msgs_py.catalogue import Catalogue

CATALOGUE = Catalogue.load()
TABLE = AxisConfigTable.load()
MEMBERS = list(TABLE.members.values())
PARAMETERS = parameters(CATALOGUE)
SAVE, FACTORY = CATALOGUE.bits["storage_request"]["SAVE"], CATALOGUE.bits["storage_request"]["FACTORY"]

SECTOR: Final = 256
ROOM: Final = 2 * SECTOR  # of a copy
HEAD: Final = 4
FORMAT: Final = 0x32535653
VALUES: Final = sum(v.count for v in PARAMETERS)
SEAL: Final = HEAD + VALUES + 2 * len(TABLE)
COMMANDS: Final = 2 + SEAL + 1  # of a save: two sectors, every word

Words = NDArray[Any]
Values = tuple[Any, ...]


class Command(NamedTuple):
    """A flash command and the content of the flash before it."""

    erases: bool
    at: int
    value: int
    before: Words

    def torn(self, changed: Words) -> Words:
        """Content after a power failure when only the bits of the mask `changed` (of a sector) had changed."""
        words: Words = self.before.copy()
        if self.erases:
            words[SECTOR * self.at : SECTOR * (self.at + 1)] |= changed
        else:
            words[self.at] &= self.value | ~changed[0]
        return words


class StorageBench(BlockBench):
    """A board with access to its data flash and a power switch."""

    def __init__(self, core: Core, flash: Words | None = None) -> None:
        super().__init__(core)
        self.tokens = iter(range(1, 1 << 16))
        if flash is not None:
            self.start(flash)

    def start(self, flash: Words) -> None:
        """Power on with this content of the flash."""
        ffi, lib = self.core.ffi, self.core.lib
        ffi.memmove(self.servo, bytes(ffi.sizeof("servo_t")), ffi.sizeof("servo_t"))
        lib.fake_hal_init(self.hal)
        ffi.memmove(self.hal.flash, flash.tobytes(), flash.nbytes)
        lib.servo_init(self.servo, self.hal, lib.probe_config())

    @property
    def flash(self) -> Words:
        words: Words = np.frombuffer(self.core.ffi.buffer(self.hal.flash), np.uint32).copy()
        return words

    def values(self) -> Values:
        """All values that are stored; the blocks from the memory, which is much faster than their transfer."""
        named = (tuple(self.read_words(v.name)) for v in PARAMETERS)
        member = self.core.lib.axis_member_get
        blocks = (tuple(member(self.axis(i).config, number) for number in range(len(TABLE))) for i in range(2))
        return (*named, *blocks)

    def request(self, kind: int, token: int | None = None) -> bool:
        return self.write_words("storage.request", [kind, next(self.tokens) if token is None else token])

    def finish(self) -> str:
        """Run the background until the request is done; return the reason of a refusal."""
        for _ in range(20_000):
            if self.servo.storage_status.state == 0:
                return self.refusal()
            self.core.lib.servo_background(self.servo)
        raise AssertionError("the request never ends")

    def commands(self, kind: int) -> Iterator[Command]:
        """Execute a request; yield each flash command before its effect."""
        assert self.request(kind)
        seen = self.hal.flash_commands
        while self.servo.storage_status.state != 0:
            self.core.lib.servo_background(self.servo)
            if self.hal.flash_commands != seen:
                seen = self.hal.flash_commands
                yield Command(self.hal.flash_erases, self.hal.flash_at, self.hal.flash_value, self.flash)
        assert self.refusal() == "NONE"

    def begin(self, kind: int, command: int) -> None:
        """Execute a request up to the start of its flash command number `command` (from 1)."""
        first = self.hal.flash_commands
        assert self.request(kind)
        while self.hal.flash_commands < first + command:
            self.core.lib.servo_background(self.servo)

    def keep(self) -> None:
        assert self.request(SAVE)
        assert self.finish() == "NONE"

    def label(self, name: str) -> str:
        (raw,) = self.read_words(name)
        return CATALOGUE.label(CATALOGUE[name].enum or "", raw)

    def refusal(self) -> str:
        return self.label("storage.refusal")

    def source(self) -> str:
        return self.label("storage.source")

    def copies(self) -> list[str]:
        return [CATALOGUE.label("stored_copy_t", raw) for raw in self.read_words("storage.copy")]

    def change(self, speed: float, gain: int) -> None:
        """Change a parameter and a member of the configuration."""
        self.set_parameter("speed_limit", speed)
        block = read_block(self, 1)
        send_block(self, 1, {**block, "position_gain": block["position_gain"] + gain})
        take_blocks(self, [1])


@pytest.fixture
def bench(core: Core) -> StorageBench:
    board = StorageBench(core)
    board.start(erased())
    board.to_stop()
    return board


def erased() -> Words:
    return np.full(2 * ROOM, 0xFFFF_FFFF, np.uint32)


def two_sets(bench: StorageBench) -> tuple[Values, Values, Words]:
    """An older set in copy A and a newer one in copy B."""
    bench.change(100.0, 1)
    older = bench.values()
    bench.keep()
    bench.change(120.0, 2)
    newer = bench.values()
    bench.keep()
    return older, newer, bench.flash


def seal(words: Words, copy: int) -> None:
    """Write the seal of a set again."""
    first = ROOM * copy
    end = first + int(words[first + 1]) - 1
    words[end] = zlib.crc32(words[first:end].tobytes())


# ---- stored values ---------------------------------------------------------------------------------------------------


def test_an_erased_flash_gives_the_built_in_values(bench: StorageBench) -> None:
    assert (bench.source(), bench.copies()) == ("BUILT_IN", ["EMPTY", "EMPTY"])
    assert bench.read_words("storage.sequence") == [0]


@settings(max_examples=25)
@given(data=st.data())
def test_all_values_are_restored_after_a_reset(core: Core, data: st.DataObject) -> None:
    bench = StorageBench(core, erased())
    bench.to_stop()
    blocks = [
        {m.name: data.draw(st.integers(*m.raw_range)) & (m.raw_range[1] if m.bits else -1) for m in MEMBERS}
        for _ in range(2)
    ]
    for axis, block in enumerate(blocks):
        send_block(bench, axis, block)
    take_blocks(bench, [0, 1])
    for v in PARAMETERS:  # a feature or feedback that the drawn block has no constants for is refused
        bench.write_words(v.name, [data.draw(st.integers(*v.raw_range)) for _ in range(v.count)])
    values = bench.values()
    bench.keep()
    bench.start(bench.flash)
    assert bench.values() == values
    assert bench.source() == "COPY_A"
    assert [read_block(bench, axis) for axis in range(2)] == blocks
    bench.slow(2)
    assert bench.read_words("config.answers") == [0]


def test_the_set_in_the_flash_has_the_documented_format(bench: StorageBench) -> None:
    bench.keep()
    words = bench.flash[:ROOM]
    raw = [word & 0xFFFF_FFFF for v in PARAMETERS for word in bench.read_words(v.name)]
    members = [word & 0xFFFF_FFFF for axis in range(2) for word in read_block(bench, axis).values()]
    assert len(raw) == VALUES
    assert list(words[:HEAD]) == [FORMAT, SEAL + 1, 1, stored_layout(CATALOGUE, TABLE)]
    assert list(words[HEAD:SEAL]) == [*raw, *members]
    assert words[SEAL] == zlib.crc32(words[:SEAL].tobytes())
    assert set(words[SEAL + 1 :]) == {0xFFFF_FFFF}


def test_copies_are_written_in_turn(bench: StorageBench) -> None:
    for number in range(1, 6):
        bench.change(100.0 + number, number)
        bench.keep()
        assert bench.read_words("storage.sequence") == [number]
        assert bench.read_words("storage.saves") == [number]
        assert bench.flash[ROOM * ((number - 1) % 2) + 2] == number
        assert bench.copies() == ["INTACT", "INTACT" if number > 1 else "EMPTY"]
        assert bench.hal.flash_commands == number * COMMANDS
    values = bench.values()
    bench.start(bench.flash)
    assert (bench.source(), bench.values()) == ("COPY_A", values)


def test_a_stored_set_moves_and_enables_nothing(bench: StorageBench) -> None:
    bench.write_raw("param.features", [0x1FFF, 0x1FFF])
    bench.keep()
    bench.start(bench.flash)
    bench.slow(2000)
    assert [state for state, _, _ in bench.states()] == [STATE.STOP, STATE.STOP]
    assert [bench.hal.axis[i].times_on for i in range(2)] == [0, 0]
    assert bench.read_words("applied_count") == [0]


def test_built_in_values_are_restored_by_the_next_reset_after_a_factory_request(bench: StorageBench) -> None:
    built_in = bench.values()
    _, newer, _ = two_sets(bench)
    assert bench.request(FACTORY)
    assert bench.finish() == "NONE"
    assert bench.values() == newer, "not before"
    assert (bench.copies(), bench.read_words("storage.sequence")) == (["EMPTY", "EMPTY"], [0])
    bench.start(bench.flash)
    assert (bench.values(), bench.source()) == (built_in, "BUILT_IN")
    bench.to_stop()
    bench.keep()
    assert bench.read_words("storage.sequence") == [1]


# ---- power fails ----------------------------------------------------------------------------------------------------


def tears(command: Command, random: np.random.Generator) -> Iterator[Words]:
    """Content after an interrupted command: no, some or all bits changed, and the lower half of each word."""
    yield command.before
    for part in (0.03, 0.5, 0.97):
        bits = random.random((SECTOR, 32)) < part
        yield command.torn(np.packbits(bits, axis=1, bitorder="little").view("<u4")[:, 0])
    yield command.torn(np.full(SECTOR, 0x0000_FFFF, np.uint32))
    yield command.torn(np.full(SECTOR, 0xFFFF_FFFF, np.uint32))


@pytest.mark.parametrize("earlier", [0, 1, 2])
def test_power_failure_during_a_save_leaves_the_old_or_the_new_set(
    core: Core, bench: StorageBench, earlier: int
) -> None:
    for number in range(earlier):
        bench.change(90.0 + number, 1)
        bench.keep()
    before = bench.values()
    bench.change(150.0, 3)
    after = bench.values()
    random = np.random.default_rng(earlier)
    other, seen, steps = StorageBench(core), set(), 0
    for command in bench.commands(SAVE):
        steps += 1
        for image in tears(command, random):
            other.start(image)
            values = other.values()
            assert values in (before, after), f"command {steps} of {COMMANDS}"
            assert (other.source() == "BUILT_IN") == (earlier == 0 and values == before)
            seen.add((values == after, steps == COMMANDS))
    assert steps == COMMANDS
    assert seen == {(False, False), (False, True), (True, True)}, (
        "the new set is valid only with the seal, the last word"
    )


def test_power_failure_during_an_erase_leaves_the_old_or_the_built_in_set(core: Core, bench: StorageBench) -> None:
    built_in = bench.values()
    _, newer, _ = two_sets(bench)
    random = np.random.default_rng(0)
    other, steps, seen = StorageBench(core), 0, set()
    for command in bench.commands(FACTORY):
        steps += 1
        assert command.erases
        for image in tears(command, random):
            other.start(image)
            assert other.values() in (built_in, newer)
            seen.add((steps, other.values() == newer))
    assert steps == 4
    assert {number for number, kept in seen if kept} == {1, 2, 3}
    assert {number for number, kept in seen if not kept} == {3, 4}


def test_after_a_power_failure_the_next_save_works(core: Core, bench: StorageBench) -> None:
    _, newer, _ = two_sets(bench)
    for command in bench.commands(SAVE):
        if command.at == 40 and not command.erases:
            break
    bench.start(command.before)
    assert (bench.copies(), bench.source(), bench.values()) == (["DAMAGED", "INTACT"], "COPY_B", newer)
    bench.to_stop()
    bench.change(77.0, 5)
    values = bench.values()
    bench.keep()
    bench.start(bench.flash)
    assert (bench.copies(), bench.source(), bench.values()) == (["INTACT", "INTACT"], "COPY_A", values)


# ---- damage ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("word", range(SEAL + 1))
def test_a_damaged_word_restores_the_older_set(core: Core, word: int) -> None:
    older, _, flash = kept_sets(core)
    random = np.random.default_rng(word)
    bench = StorageBench(core)
    for change in (0x0000_0001, 0x8000_0000, int(random.integers(1, 1 << 32)), int(flash[ROOM + word]) or 1):
        damaged = flash.copy()
        damaged[ROOM + word] ^= change
        bench.start(damaged)
        assert (bench.copies(), bench.source()) == (["INTACT", "DAMAGED"], "COPY_A")
        assert bench.values() == older
        damaged[word] ^= change
        bench.start(damaged)
        assert (bench.copies(), bench.source()) == (["DAMAGED", "DAMAGED"], "BUILT_IN")


_kept: dict[int, tuple[Values, Values, Words]] = {}


def kept_sets(core: Core) -> tuple[Values, Values, Words]:
    if not _kept:
        bench = StorageBench(core, erased())
        bench.to_stop()
        _kept[0] = two_sets(bench)
    return _kept[0]


@settings(max_examples=200)
@given(data=st.data())
def test_random_contents_are_never_accepted_as_a_set(core: Core, data: st.DataObject) -> None:
    bench = StorageBench(core)
    words = erased()
    built_in = None
    for place, word in data.draw(st.dictionaries(st.integers(0, 2 * ROOM - 1), st.integers(0, 2**32 - 1))).items():
        words[place] = word
    if data.draw(st.booleans()):
        words[0], words[1] = FORMAT, data.draw(st.integers(0, 2**32 - 1))
    bench.start(words)
    built_in = StorageBench(core, erased()).values()
    assert (bench.source(), bench.values()) == ("BUILT_IN", built_in)


@pytest.mark.parametrize(("word", "value"), [(0, 0x31535653), (1, SEAL), (3, 1)])
def test_a_set_of_another_firmware_is_reported_and_overwritten_last(core: Core, word: int, value: int) -> None:
    older, _, flash = kept_sets(core)
    flash = flash.copy()
    flash[ROOM + word] = value
    seal(flash, 1)
    bench = StorageBench(core, flash)
    assert (bench.copies(), bench.source(), bench.values()) == (["INTACT", "OTHER_LAYOUT"], "COPY_A", older)
    flash[0] = 0
    bench.start(flash)
    assert (bench.copies(), bench.source()) == (["DAMAGED", "OTHER_LAYOUT"], "BUILT_IN")
    bench.to_stop()
    bench.keep()
    assert bench.copies() == ["INTACT", "OTHER_LAYOUT"]
    assert bench.read_words("storage.sequence") == [3]
    bench.start(bench.flash)
    assert bench.source() == "COPY_A"


def test_a_value_out_of_range_in_the_flash_invalidates_its_set(core: Core) -> None:
    older, _, kept = kept_sets(core)
    bench = StorageBench(core)
    place = HEAD
    limits = [v.raw_range for v in PARAMETERS for _ in range(v.count)]
    limits += [m.raw_range for _ in range(2) for m in MEMBERS]
    refused = 0
    for place, (low, high) in enumerate(limits, HEAD):
        for wrong in (low - 1, high + 1):
            if not -(1 << 31) <= wrong < 1 << 31:
                continue
            flash = kept.copy()
            flash[ROOM + place] = wrong & 0xFFFF_FFFF
            seal(flash, 1)
            bench.start(flash)
            assert (bench.copies(), bench.source()) == (["INTACT", "OUT_OF_RANGE"], "COPY_A")
            assert bench.values() == older
            refused += 1
    assert refused > len(limits) / 2


def test_state_of_a_damaged_copy_is_logged(core: Core) -> None:
    _, _, flash = kept_sets(core)
    flash = flash.copy()
    flash[ROOM + 9] ^= 1
    bench = StorageBench(core, flash)
    events = [bench.servo.event_log.event[k].value for k in range(bench.servo.event_log.count)]
    assert events == [0, 1 << 8 | CATALOGUE.enums["stored_copy_t"]["DAMAGED"]]


# ---- requests -------------------------------------------------------------------------------------------------------


def test_a_repeated_request_is_executed_once(bench: StorageBench) -> None:
    """The host repeats a request if the answer was lost, while it is pending and after its end."""
    assert bench.request(SAVE, 7)
    bench.core.lib.servo_background(bench.servo)
    assert bench.request(SAVE, 7)
    assert bench.finish() == "NONE"
    for _ in range(3):
        assert bench.request(SAVE, 7)
        assert bench.finish() == "NONE"
    assert bench.read_words("storage.saves") == [1]
    assert bench.read_words("storage.sequence") == [1]
    assert bench.read_words("storage.answered") == [7]
    assert not bench.request(FACTORY, 7)
    assert bench.refusal() == "FORM"
    assert bench.request(SAVE, 8)
    assert bench.finish() == "NONE"
    assert bench.read_words("storage.saves") == [2]


@pytest.mark.parametrize("words", [[0, 1], [3, 1], [1, 0], [1]])
def test_a_malformed_request_is_refused(bench: StorageBench, words: Sequence[int]) -> None:
    assert not bench.write_words("storage.request", words)
    assert bench.refusal() == "FORM"
    assert bench.hal.flash_commands == 0


def test_a_second_request_is_refused_while_one_is_pending(bench: StorageBench) -> None:
    assert bench.request(SAVE)
    assert not bench.request(FACTORY)
    assert bench.refusal() == "BUSY"
    assert bench.finish() == "NONE"
    assert bench.copies() == ["INTACT", "EMPTY"]


def test_nothing_is_written_while_an_axis_is_not_at_rest(bench: StorageBench) -> None:
    bench.to_spin(1)
    assert not bench.request(SAVE)
    assert bench.refusal() == "MOTION"
    bench.write(1, enable=0)
    bench.until(lambda: bench.view(1).state == STATE.STOP, 5000)
    bench.keep()
    bench.turn(0, 20.0)
    bench.slow(100)
    assert not bench.request(FACTORY)
    assert bench.hal.flash_commands == COMMANDS


@pytest.mark.parametrize("step", [1, 2, 3, 100, COMMANDS])
def test_an_axis_enabled_during_a_save_starts_and_the_old_set_remains(bench: StorageBench, step: int) -> None:
    _, newer, _ = two_sets(bench)
    bench.hal.flash_polls = 40
    bench.change(60.0, 9)
    bench.begin(SAVE, step)
    bench.write(0, enable=1)
    bench.until(lambda: bench.view(0).state == STATE.RUN, 10)
    assert bench.finish() in ("MOTION", "NONE")
    bench.start(bench.flash)
    assert bench.copies()[1] == "INTACT"
    assert (bench.values() == newer) == (step < COMMANDS)


@pytest.mark.parametrize("what", ["parameter", "block"])
def test_values_changed_during_a_save_cancel_the_save(bench: StorageBench, what: str) -> None:
    _, newer, _ = two_sets(bench)
    bench.begin(SAVE, 100)
    if what == "parameter":
        bench.set_parameter("i_q_limit", 0.5)
    else:
        block = read_block(bench, 0)
        send_block(bench, 0, {**block, "position_gain": block["position_gain"] + 1})
        take_blocks(bench, [0])
    assert bench.finish() == "CHANGED"
    assert bench.copies() == ["DAMAGED", "INTACT"]
    bench.start(bench.flash)
    assert bench.values() == newer


@pytest.mark.parametrize("wrong", ["controller", "bit"])
def test_failed_verification_of_the_flash_is_reported(bench: StorageBench, wrong: str) -> None:
    _, newer, _ = two_sets(bench)
    bench.begin(SAVE, 60)
    if wrong == "controller":
        bench.hal.flash_fails = True
    else:
        bench.hal.flash_stuck = 0x10
    assert bench.finish() == "FLASH"
    bench.start(bench.flash)
    assert bench.values() == newer


def test_a_board_without_data_flash_reports_it(bench: StorageBench) -> None:
    bench.hal.flash_absent = True
    bench.core.lib.servo_init(bench.servo, bench.hal, bench.core.lib.probe_config())
    bench.to_stop()
    assert (bench.copies(), bench.source()) == (["ABSENT", "ABSENT"], "BUILT_IN")
    assert not bench.request(SAVE)
    assert bench.refusal() == "ABSENT"


def test_the_server_waits_during_a_flash_command(bench: StorageBench) -> None:
    """The tables of the server are in the data flash: it receives bytes, and answers between two flash commands."""
    bench.hal.flash_polls = 10
    assert bench.request(SAVE)
    bench.core.lib.servo_background(bench.servo)
    bench.receive_read()
    for _ in range(9):
        bench.core.lib.servo_background(bench.servo)
        assert bench.hal.serial_out_size == 0
    assert bench.hal.serial_in_taken == bench.hal.serial_in_size > 0, "all bytes have been fetched"
    tick = bench.servo.snapshot.tick
    bench.slow(2)
    assert bench.hal.serial_out_size > 0
    assert bench.servo.snapshot.tick == tick + 16
    assert bench.finish() == "NONE"
    assert bench.hal.flash_reads == 0
