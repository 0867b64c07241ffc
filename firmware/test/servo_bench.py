"""Test bench: the complete firmware on the fake board, with shafts that the test moves."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any, Final

from core_library import Core
from quad_timer import AGE_OVERFLOW, COUNTS, QuadTimer
from servo_msgs_py.catalogue import Catalogue

CATALOGUE: Final = Catalogue.load()


def _masks(word: str) -> SimpleNamespace:
    """Masks of the flags of a word, by name."""
    return SimpleNamespace(**{flag.name: flag.mask for flag in CATALOGUE.flags[word]})


STATE, SUBSTATE, MODE, TEST_POINT, STOP_CATEGORY = (
    SimpleNamespace(**CATALOGUE.enums[name])
    for name in ("state_t", "substate_t", "control_mode_t", "test_point_t", "stop_category_t")
)
FAULTS, LIMITS, FEATURES, INPUTS = map(_masks, ("faults", "limits", "features", "inputs"))
ALL_FAULTS: Final = sum(vars(FAULTS).values())
REFERENCE_FEATURES: Final = 0b1111
"""Features of the reference design, enabled after reset."""
PULL, BRAKE, REST, VERIFY, TURN, FOUND, HELD, BLIND, REVERSED, STARVED = range(10)  # rotor_search_phase_t
PERIODS: Final = 8
VARIABLES: Final = 0x1000
TIMER_PER_TICK: Final = 390.625
FULL_SPEED: Final = 523.5987755982989  # rad/s
TICK: Final = 0.5e-3  # s
COUNT: Final = 2.0 * math.pi / 4000  # rad
CODE_24V: Final = 2708


@cache
def _offset(core: Core, path: str) -> int:
    """Offset of a variable in ``servo_t``."""
    parts = path.replace("[", ".").replace("]", "").split(".")
    offset: int = core.ffi.offsetof("servo_t", *(int(part) if part.isdigit() else part for part in parts))
    return offset


def speed(rad_s: float) -> int:
    """Raw number of a speed [rad/s]."""
    return round(rad_s / FULL_SPEED * 2**31)


def rad_s(raw: int) -> float:
    """Speed of a raw number [rad/s]."""
    return raw / 2**31 * FULL_SPEED


def amps(current: float) -> int:
    """Raw number of a current [A]."""
    return round(current / 8.25 * 2**15)


def bus_code(volts: float) -> int:
    """Code of the 12-bit converter for a bus voltage [V]."""
    return round(volts / 36.3 * 4096)


class Bench:
    """Two axes that a test commands through the variables of the contract."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self.catalogue = Catalogue.load()
        self.hal: Any = core.ffi.new("hal_t *")  # the fake board; tests may read and write its members
        self.servo: Any = core.ffi.new("servo_t *")  # state of the firmware; tests may read and write its members
        self.shaft = [QuadTimer(), QuadTimer()]  # encoders, moved by `turn` and the rotor search
        self._rotor = [0.3, -0.2]  # turns electrical between the rotor and encoder zero
        self._speed = [0.0, 0.0]  # counts per slow tick
        self._fraction = [0.0, 0.0]
        self.shaft_is_free = [True, True]  # False: blocked in the rotor search
        self.motor_plugged = [True, True]
        self.current_across = [0.0, 0.0]  # across the vector of the search, relative to full scale
        self._search_drives = [False, False]
        self._read_count = [0, 0]  # counter value that the firmware last read
        self.ticks = 0
        self.references: list[Any] = []  # objects to which the firmware has pointers
        core.lib.fake_hal_init(self.hal)
        core.lib.servo_init(self.servo, self.hal, core.lib.probe_config())
        self.servo.parameter.command_timeout = 0  # set-points do not expire
        for axis in range(2):
            # The board has no current at any voltage, which would be a lost phase.
            self.servo.parameter.faults_enabled[axis] = ALL_FAULTS & ~FAULTS.PHASE_LOST

    # ---- time ----------------------------------------------------------------------------------------------------

    def slow(self, ticks: int = 1) -> None:
        """Run slow ticks, each until just after its snapshot. Parameters that the test wrote to memory are applied."""
        self.servo.marks.parameters |= 2  # PARAMETERS_RENEWED
        for _ in range(ticks):
            self.ticks += 1
            for i in range(2):
                self._move(i)
            self.core.lib.probe_run(self.servo, PERIODS)

    def until(self, condition: Callable[[], bool], ticks: int) -> int:
        """Run until a condition holds; return the number of ticks, fail after `ticks`."""
        for k in range(ticks):
            if condition():
                return k
            self.slow()
        assert condition(), f"not within {ticks} slow ticks: {self.states()}"
        return ticks

    def _move(self, i: int) -> None:
        timer, hal = self.shaft[i], self.hal.axis[i]
        if hal.count != self._read_count[i]:  # the firmware has preset it
            timer.count = hal.count - 65536 if hal.count > 32767 else hal.count
        self._fraction[i] += self._speed[i]
        edges = round(self._fraction[i])
        self._fraction[i] -= edges
        self._follow_search(i)
        timer.move(edges)
        if edges:
            hal.edge.count, hal.edge.time = timer.raw, int(self.ticks * TIMER_PER_TICK) & 0xFFFF
            hal.edge_waits = True
            hal.age = 0
        else:
            hal.age = min(hal.age + 391, AGE_OVERFLOW)
        hal.count, hal.index = timer.raw, timer.index
        self._read_count[i] = timer.raw

    def _follow_search(self, i: int) -> None:
        """Rotor without friction that moves towards the vector of the search, with ideal current control."""
        axis = self.axis(i)
        aligning = (axis.sm.state, axis.substate) == (STATE.RUN, SUBSTATE.ALIGN)
        if self._search_drives[i] or aligning:
            self._search_drives[i] = aligning and axis.search.phase in (PULL, BRAKE, VERIFY, TURN)
            self._flow(i)
        if not aligning or axis.search.phase not in (PULL, VERIFY) or axis.search.current == 0:
            return
        rotor = self._rotor[i] + self.shaft[i].shaft * 2 / COUNTS
        towards = (axis.search.vector / 65536 - rotor + 0.5) % 1.0 - 0.5
        if self.shaft_is_free[i] and axis.search.phase == VERIFY:
            self.shaft[i].move(round(towards * COUNTS / 2))
        elif self.shaft_is_free[i] and abs(towards) > 0.002:
            self.shaft[i].move(4 if towards > 0 else -4)
            self.hal.axis[i].age = 0

    def _flow(self, i: int) -> None:
        """Currents during the search: its set-point along the vector, and `current_across` across it."""
        search, flows = self.axis(i).search, self._search_drives[i] and self.motor_plugged[i]
        along, across = (search.current / 2**31, self.current_across[i]) if flows else (0.0, 0.0)
        for phase in range(3):
            angle = search.vector * math.pi / 32768 - phase * 2.0 * math.pi / 3.0
            current = along * math.cos(angle) - across * math.sin(angle)
            self.hal.axis[i].current_code[phase] = round(2048 * (1.0 + current))

    def turn(self, axis: int, speed: float) -> None:
        """Rotate a shaft at a constant speed [rad/s], independent of the firmware."""
        self._speed[axis] = speed * 0.5e-3 * COUNTS / 6.283185307179586

    def trace(self, ticks: int, value: Callable[[], Any], axis: int = 0, *, follow: bool = True) -> list[Any]:
        """Values after each tick; with `follow` an ideal shaft has the speed of the set-point."""
        values = []
        for _ in range(ticks):
            if follow:
                self.turn(axis, rad_s(self.view(axis).speed_ref))
            self.slow()
            values.append(value())
        return values

    def follow(self, ticks: int, axis: int = 0) -> list[tuple[int, int]]:
        """Move an ideal shaft at the speed set-point; return position_ref and position of every tick."""
        view = self.view(axis)
        return self.trace(ticks, lambda: (view.position_ref, view.position), axis)

    def turn_without_current(self, axis: int, speed: float) -> None:
        """Rotate a spinning axis by an external torque [rad/s] in torque mode with zero current."""
        self.write(axis, mode=MODE.TORQUE, i_q=0)
        self.turn(axis, speed)

    # ---- host ------------------------------------------------------------------------------------------

    def address(self, name: str, element: int = 0) -> int:
        """Address of a variable or of one of its elements in the protocol."""
        variable = self.catalogue.variables[name]
        return VARIABLES + _offset(self.core, variable.path) + element * variable.element_size

    def write_raw(self, name: str, raw: Sequence[int]) -> None:
        """Write a whole variable, raw."""
        data = self.catalogue.variables[name].encode_raw(raw)
        assert self.core.lib.servo_write(self.servo, self.address(name), data, len(data)) == 0

    def configure_pins(self, pins: int, axis: int = 0, **times: int) -> Any:
        """Configure pins of an axis (INPUT_ bits) and times of its brake [slow ticks]; return the configuration."""
        config = self.core.ffi.new("axis_config_t *", self.axis(axis).config[0])
        config.pins.fitted = pins
        for name, ticks in times.items():
            setattr(config.pins, name, ticks)
        self.references.append(config)
        self.axis(axis).config = config
        self.slow(3)
        return config

    def write(self, axis: int, **commands: int) -> None:
        """Write raw commands of one axis, in order: ``write(0, mode=SPEED, speed=1000)``."""
        for name, value in commands.items():
            variable = self.catalogue.variables[f"cmd.{name}"]
            data = int(value).to_bytes(variable.element_size, "little", signed=value < 0)
            assert self.core.lib.servo_write(self.servo, self.address(variable.name, axis), data, len(data)) == 0

    def set_parameter(self, name: str, value: float) -> None:
        """Write a parameter of both axes, in SI units."""
        variable = self.catalogue.variables[f"param.{name}"]
        raw = variable.to_raw(value)
        self.write_raw(variable.name, [raw] * variable.count)

    def switch_on(self, axis: int, features: int) -> None:
        """Enable features of one axis in addition to those of the reference design."""
        words = [REFERENCE_FEATURES, REFERENCE_FEATURES]
        words[axis] |= features
        self.write_raw("param.features", words)

    def keep_alive(self) -> None:
        """Send the application command KEEP_ALIVE (0x30 SENDAPPCMD, 0x31 GETAPPCMDSTS)."""
        for body in (bytes([0x30, 1, self.catalogue.bits["command"]["KEEP_ALIVE"]]), bytes([0x31, 0])):
            self._receive_frame(body)
            self.core.lib.servo_background(self.servo)

    def receive_read(self) -> None:
        """Receive a request that reads the catalogue hash (0x21 READMEM)."""
        self._receive_frame(bytes([0x21, 3, 0x80, 0x20, 4]))

    def _receive_frame(self, body: bytes) -> None:
        crc = 0
        for byte in body:
            crc = self.core.lib.crc8_add(crc, byte)
        for k, byte in enumerate(b"+" + body + bytes([crc])):
            self.hal.serial_in[k] = byte
        self.hal.serial_in_taken, self.hal.serial_in_size = 0, len(body) + 2
        self.hal.serial_out_size = 0

    def axis(self, i: int) -> Any:
        """``axis_t`` of the firmware."""
        return self.servo.axis[i]

    def view(self, i: int) -> Any:
        """The published snapshot of an axis."""
        return self.servo.snapshot.axis[i]

    def states(self) -> list[tuple[int, int, int]]:
        """Main state, sub-state and faults of both axes, as published."""
        return [(self.view(i).state, self.view(i).substate, self.view(i).faults) for i in range(2)]

    # ---- transitions ------------------------------------------------------------------------------------------

    def to_stop(self) -> None:
        self.until(lambda: all(self.view(i).state == STATE.STOP for i in range(2)), 100)

    def to_substate(self, axis: int, substate: int, ticks: int = 2000) -> None:
        self.until(lambda: (self.view(axis).state, self.view(axis).substate) == (STATE.RUN, substate), ticks)

    def to_spin(self, *axes: int) -> None:
        """Enable axes from any state without a fault, and wait until they spin."""
        self.to_stop()
        for axis in axes:
            self.write(axis, enable=1)
        for axis in axes:
            self.to_substate(axis, SUBSTATE.SPIN)

    def clear(self, axis: int) -> None:
        self.write(axis, clear_faults=1)
        self.slow()

    # ---- calls of the firmware ---------------------------------------------------------------------------

    def log(self) -> None:
        """Start to record the calls of the firmware."""
        self.hal.events, self.hal.logging = 0, True

    def calls(self) -> list[tuple[str, int, int]]:
        """Stop recording and return the calls: name, axis, value."""
        assert self.hal.events < len(self.hal.event), "the log is full"
        self.hal.logging = False
        names = self.core.ffi.typeof("fake_call_t").elements
        events = [self.hal.event[k] for k in range(self.hal.events)]
        return [(names[e.call].removeprefix("FAKE_").lower(), e.axis, e.value) for e in events]
