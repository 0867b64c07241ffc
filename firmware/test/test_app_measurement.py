"""A measurement session: at its end the board restores configuration and parameters itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from block_bench import OUT_OF_RANGE, BlockBench
from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_bench import CATALOGUE, FEATURES, MODE, STATE, STOP_CATEGORY, SUBSTATE, amps, speed
from servo_msgs_py.axis_config_transfer import BlockRefusedError, read_block, send_block, take_blocks
from servo_msgs_py.timed_points import TimedPoint, encode_points

NAMES = [name for name, v in CATALOGUE.variables.items() if name.startswith("param.")]
KEPT = [*NAMES, "cmd.mode", "cmd.speed", "cmd.i_q"]
NONE, OPEN, RESTORING = (CATALOGUE.enums["measurement_state_t"][name] for name in ("NONE", "OPEN", "RESTORING"))
END = CATALOGUE.enums["measurement_end_t"]
HOST_TIMEOUT = 1000  # slow ticks
SAVE = CATALOGUE.bits["storage_request"]["SAVE"]


class Session(BlockBench):
    """A bench whose background loop runs after every slow tick."""

    def background(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.slow()
            self.hal.serial_in_taken = self.hal.serial_in_size = 0
            self.core.lib.servo_background(self.servo)

    def begin(self, axis: int = 0) -> bool:
        return self.write_words("measurement.axis", [axis + 1])

    def close(self) -> None:
        assert self.write_words("measurement.axis", [0])

    @property
    def state(self) -> int:
        return self.read_words("measurement.state")[0]

    @property
    def ended(self) -> int:
        return self.read_words("measurement.ended")[0]

    def until_restored(self, ticks: int) -> int:
        for k in range(ticks):
            if self.state == NONE:
                return k
            self.background()
        assert self.state == NONE, self.states()
        return ticks

    def values(self) -> dict[str, object]:
        """Everything that a session restores."""
        return {
            **{name: self.read_words(name) for name in KEPT},
            "blocks": [read_block(self, axis) for axis in range(2)],
            "checksum": self.read_words("config.checksum"),
            "latched": (self.axis(0).latch.enabled, self.axis(0).parameter.features, self.axis(0).command.mode),
        }

    def take(self, axis: int, block: dict[str, int]) -> None:
        send_block(self, axis, block)
        take_blocks(self, [axis])

    def write_one(self, name: str, word: int, axis: int = 0) -> int:
        data = CATALOGUE[name].pack([word])
        status: int = self.core.lib.servo_write(self.servo, self.address(name, axis), data, len(data))
        return status


@pytest.fixture
def bench(core: Core) -> Session:
    board = Session(core)
    board.write_raw("param.host_timeout", [HOST_TIMEOUT])
    board.write_raw("cmd.mode", [MODE.SPEED, MODE.POSITION])
    # a configuration and parameters that are neither built in nor stored
    board.to_stop()
    board.take(0, {**read_block(board, 0), "u_dc_max": 30000, "i_q_limit": amps(2.0)})
    board.write_raw("param.speed_limit", [speed(123.0), speed(45.0)])
    board.background(3)
    return board


def change_all(bench: Session, axis: int = 0) -> None:
    """Changes of an identification: no monitors, other features, several configurations."""
    bench.write_one("param.faults_enabled", 0, axis)
    bench.write_one("param.features", FEATURES.BUS_COMPENSATION, axis)
    for k in range(3):
        bench.take(axis, {**read_block(bench, axis), "u_dc_max": 31000 + k, "i_q_limit": amps(1.0) + k, "features": k})
    bench.write_raw("param.command_timeout", [2000])
    bench.write_raw("param.position_max", [5, 6])
    bench.write_one("cmd.mode", MODE.TORQUE, axis)
    bench.background(3)


def quick_stop(bench: Session) -> None:
    for body in (bytes([0x30, 1, CATALOGUE.bits["command"]["QUICK_STOP"]]), bytes([0x31, 0])):
        bench._receive_frame(body)
        bench.core.lib.servo_background(bench.servo)


def go_silent(bench: Session) -> None:
    bench.background(HOST_TIMEOUT + 2)


ENDS: dict[str, Callable[[Session], None]] = {
    "CLOSED": Session.close,
    "SILENT": go_silent,
    "STOPPED": quick_stop,
    "REPLACED": lambda bench: None if not bench.begin(1) else pytest.fail("a second session was accepted"),
}


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("end", ENDS)
def test_values_of_the_beginning_are_restored_at_every_end(bench: Session, end: str, axis: int) -> None:
    before = bench.values()
    assert bench.begin(axis)
    assert bench.state == OPEN
    bench.keep_alive()
    change_all(bench, axis)
    assert bench.values() != before
    ENDS[end](bench)
    bench.until_restored(20)
    bench.background(3)
    assert bench.values() == before
    assert bench.ended == END[end]
    assert bench.begin(axis), "the next session"


def test_at_most_two_points_are_written_together_until_the_parameters_are_restored(bench: Session) -> None:
    """The rest of their memory keeps the parameters."""
    refusals = CATALOGUE.enums["point_refusal_t"]

    def refusal(points: int) -> int:
        assert not bench.write_words("cmd.points", [-1] * 4 * points)
        bench.background()
        return bench.read_words("point_refusal")[0]

    assert refusal(3) == refusals["FORM"]
    before = bench.values()
    assert bench.begin()
    assert (refusal(3), refusal(2)) == (refusals["MEASUREMENT"], refusals["FORM"])
    bench.to_spin(0)
    bench.close()
    assert bench.state == RESTORING
    assert (refusal(3), refusal(2)) == (refusals["MEASUREMENT"], refusals["FORM"])
    bench.until_restored(4000)
    assert bench.values() == before
    assert refusal(3) == refusals["FORM"]


def test_points_of_a_session_leave_the_parameters(bench: Session) -> None:
    bench.write_one("cmd.mode", MODE.TRAJECTORY)
    bench.to_spin(0)
    before = bench.values()
    assert bench.begin()
    bench.write_raw("param.speed_limit", [speed(100.0), speed(100.0)])
    place = CATALOGUE["axis1.position"].lsb * bench.read_words("axis1.position_ref")[0]
    points = [TimedPoint(0, bench.read_words("tick")[0] + 1600 * k, place, 0.0) for k in (1, 2)]
    assert bench.write_words("cmd.points", encode_points(CATALOGUE, points))
    bench.close()
    bench.until_restored(4000)
    bench.background(3)
    assert bench.values() == before
    assert bench.read_words("axis1.points_taken") == [2]


def test_session_with_a_moving_shaft_stops_it_first(bench: Session) -> None:
    before = bench.values()
    assert bench.begin()
    change_all(bench)
    bench.to_spin(0)
    bench.turn_without_current(0, 100.0)
    bench.background(200)
    bench.close()
    bench.background(3)
    assert not bench.axis(0).enable_requested
    bench.to_substate(0, SUBSTATE.FREEWHEEL, 12_000)
    bench.background(50)
    assert bench.state == RESTORING, "the shaft rotates"
    assert bench.write_one("cmd.enable", 1) == OUT_OF_RANGE, "the axis cannot be enabled with the other motor"
    assert bench.write_one("cmd.enable", 0) == 0
    assert bench.write_one("cmd.enable", 1, 1) == 0
    assert not bench.write_words("cmd.enable", [1, 1])
    assert bench.write_one("cmd.enable", 0, 1) == 0
    bench.turn(0, 0.0)
    bench.until_restored(2000)
    bench.background(3)
    assert bench.values() == before
    bench.until(lambda: bench.view(1).state == STATE.STOP, 4000)
    bench.to_spin(0)


def test_axis_stays_enabled_when_its_session_took_no_configuration(bench: Session) -> None:
    bench.to_spin(0)
    before = bench.values()
    assert bench.begin()
    bench.write_one("param.features", 0)
    bench.background(3)
    bench.close()
    assert bench.until_restored(5) <= 1
    bench.background(3)
    assert (bench.view(0).state, bench.view(0).substate) == (STATE.RUN, SUBSTATE.SPIN)
    assert bench.values() == before


def test_axis_that_was_enabled_during_the_session_is_disabled(bench: Session) -> None:
    assert bench.begin()
    bench.to_spin(0)
    bench.close()
    bench.until_restored(4000)
    assert bench.view(0).state == STATE.STOP


def test_first_command_after_a_silence_begins_a_session(bench: Session) -> None:
    bench.keep_alive()
    go_silent(bench)
    assert bench.servo.host_silent
    bench.keep_alive()
    assert bench.begin()
    bench.core.lib.servo_background(bench.servo)  # before the next slow tick
    assert bench.state == OPEN
    bench.background(3)
    assert bench.state == OPEN


@pytest.mark.parametrize("enabled", [False, True])
def test_blocks_pending_at_the_end_are_taken_back(bench: Session, enabled: bool) -> None:
    """The board restores its values after the next slow tick, in which it takes them."""
    if enabled:
        bench.to_spin(0)
    before = bench.values()
    assert bench.begin()
    block = read_block(bench, 0)
    send_block(bench, 0, {**block, "current_loop.d.kp": block["current_loop.d.kp"] - 1})
    assert bench.write_words("config.take", [1])
    bench.close()
    bench.core.lib.servo_background(bench.servo)  # before the next slow tick
    bench.background(3)
    bench.until_restored(4000)
    assert {name: bench.values()[name] for name in ("blocks", "checksum")} == {
        name: before[name] for name in ("blocks", "checksum")
    }


def test_keep_alives_continue_a_session(bench: Session) -> None:
    assert bench.begin()
    for _ in range(5):
        bench.keep_alive()
        bench.background(HOST_TIMEOUT - 100)
        assert bench.state == OPEN


def test_other_requests_are_refused_during_a_session(bench: Session) -> None:
    assert bench.begin()
    with pytest.raises(BlockRefusedError, match="a measurement uses them"):
        send_block(bench, 1, read_block(bench, 1))
    assert not bench.write_words("config.take", [2])
    assert not bench.write_words("storage.request", [SAVE, 77])
    assert CATALOGUE.label("storage_refusal_t", bench.read_words("storage.refusal")[0]) == "BUSY"
    bench.close()
    bench.until_restored(5)
    send_block(bench, 1, read_block(bench, 1))


def test_reset_ends_a_session(bench: Session) -> None:
    assert bench.begin()
    change_all(bench)
    bench.core.lib.servo_init(bench.servo, bench.hal, bench.core.lib.probe_config())
    assert (bench.state, bench.ended) == (NONE, END["NONE"])
    assert bench.read_words("param.faults_enabled")[0] != 0


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_any_writes_of_a_session_are_taken_back(core: Core, data: st.DataObject) -> None:
    bench = Session(core)
    bench.to_stop()
    axis = data.draw(st.integers(0, 1))
    before = bench.values()
    assert bench.begin(axis)
    for name in data.draw(st.lists(st.sampled_from(NAMES), max_size=6)):
        variable = CATALOGUE[name]
        low, high = variable.raw_range
        words: Sequence[int] = data.draw(
            st.lists(st.integers(low, high), min_size=variable.count, max_size=variable.count)
        )
        assert bench.write_words(name, words)
        if data.draw(st.booleans()):
            block = read_block(bench, axis)
            bench.take(axis, {**block, "u_dc_max": block["u_dc_max"] - 1, "stop.disable": STOP_CATEGORY.COAST})
    bench.background(data.draw(st.integers(0, 3)))
    bench.close()
    bench.until_restored(20)
    bench.background(2)
    assert bench.values() == before
