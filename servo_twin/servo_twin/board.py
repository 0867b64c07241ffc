"""Virtual board: firmware, chip and plant.

There are two levels. ``registers``: the drivers of the firmware run on a model of the registers of the MC56F84789, and
the plant is simulated with every edge of the gate signals. ``ideal``: no registers, no conversion or computing times,
an averaged plant; faster.

Only `Board.advance`, `Board.run`, `Board.record` and `Board.trace` advance the simulated time. The same calls with the
same configuration give identical results. A process can have several boards, each used by one thread at a time; the
long calls release the GIL.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_description import DEFAULT_BOARD, BoardDescription
from servo_msgs_py.catalogue import AXES, Catalogue, Value, Variable, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import SLOW_PERIODS, TICK, TICK_NS

from servo_twin.board_memory import OUT_OF_RANGE, BoardError, BoardMemory, SimulationError, status_text
from servo_twin.board_sampler import BoardSampler
from servo_twin.board_state import BoardState
from servo_twin.core_speed import CoreSpeed
from servo_twin.fault_injection import PINS, ChangedValue, InjectedFault, NativeFault, Pin
from servo_twin.level import ELF_LEVEL, ELF_VARIABLE, Level, chosen_elf, chosen_level
from servo_twin.plant import FIXED_NAMES, PlantConfig, PlantError
from servo_twin.servo_config import ServoConfig
from servo_twin.truth import Truth

__all__ = [
    "Board",
    "BoardError",
    "BoardStats",
    "ChipError",
    "Firmware",
    "FlashState",
    "SimulationError",
]


class Firmware(NamedTuple):
    """Firmware, chip and plant, compiled by cffi."""

    ffi: Any
    lib: Any
    file: str  # path of the compiled module

    @property
    def build(self) -> str:
        """SHA-256 of the compiled module, hexadecimal: boards of one build give the same bits."""
        return hashlib.sha256(Path(self.file).read_bytes()).hexdigest()


_MODULES: Final[Mapping[str, Mapping[Level, str]]] = {
    DEFAULT_BOARD: {"registers": "servo_twin._registers", "ideal": "servo_twin._native"},
    "odrive36": {"registers": "servo_twin._odrive36", "ideal": "servo_twin._odrive36_ideal"},
}
"""Compiled modules by board and level."""

ELF_MARK: Final = "+elf:"
"""Between the hashes of compiled module and ELF file in `Board.build`."""

_LINKED: Final = frozenset({DEFAULT_BOARD})
"""Boards whose firmware is linked with the model at level registers; others execute an ELF file there."""


@cache
def build_of(board: str, level: Level) -> Firmware:
    """Build of this checkout for a board and level.

    Raises
    ------
    BoardError
        If there is no model of this board.
    ImportError
        If it has not been compiled for this Python.
    """
    if board not in _MODULES:
        raise BoardError(f"there is no firmware and no model of the board {board} yet; known are {', '.join(_MODULES)}")
    try:
        module = importlib.import_module(_MODULES[board][level])
    except ImportError as error:
        raise ImportError(
            f"the compiled part of servo_twin is missing or does not fit this Python ({error}); "
            "build it with `make build`, or `python setup.py build_ext --inplace` in the folder servo_twin"
        ) from error
    return Firmware(module.ffi, module.lib, str(module.__file__))


def needs_elf(board: str, level: Level) -> bool:
    """True if no firmware is linked with the model of a board at a level."""
    return level == ELF_LEVEL and board not in _LINKED


def flash_bytes(board: str = DEFAULT_BOARD) -> int:
    """Size of `Board.flash_image`."""
    return int(build_of(board, "ideal").lib.board_flash_size())


def firmware_of(path: Path) -> Firmware:
    """Another build for the board of this process, at level ideal.

    Parameters
    ----------
    path : Path
        Its compiled module (``_native*.so`` of the default board), or the folder of the checkout with it.

    Raises
    ------
    BoardError
        If there is no such module, or it does not fit this Python.
    """
    name = _MODULES[BoardDescription.load().name]["ideal"].rpartition(".")[2]
    found = sorted(path.glob(f"servo_twin/servo_twin/{name}.*so")) if path.is_dir() else [path]
    if not found:
        raise BoardError(f"{path} contains no compiled virtual board; run `make build` there")
    spec = importlib.util.spec_from_file_location(name, found[0])
    try:
        if spec is None or spec.loader is None:
            raise ImportError("the name must end with .so")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    except ImportError as error:
        raise BoardError(f"{found[0]} is no compiled virtual board for this Python ({error})") from None
    return Firmware(module.ffi, module.lib, str(found[0]))


_IDLE: Final = (1 << 64) - 1


class ChipError(BoardError, SimulationError):
    """The software used a function that is not modelled or would damage the chip; the board has stopped."""


TRACE_ENTRY: Final = np.dtype([("clock", "<u8"), ("kind", "<u2"), ("a", "<u2"), ("b", "<u4")])
"""Layout of an entry of a trace (``trace_entry_t`` in chip/trace.h, with the list of kinds)."""


_truth_values: Final = attrgetter(*Truth._fields)


@dataclass(frozen=True)
class BoardStats:
    """Counters of the chip since reset."""

    serial_overruns: int  # received bytes that the firmware did not read in time
    serial_lost: int  # sent bytes that the host did not read in time
    breaks: int  # trips of an over-current latch
    watchdog_services: int  # services of the watchdog by the firmware


class Leader(Protocol):
    """Another simulator that owns shafts of a board and in whose steps the time of the board elapses."""

    def end_ns(self, board: Board) -> int:
        """End of the present step of a board [ns]; begins the next one if the board has come to the end of it."""


class FlashState(NamedTuple):
    """State of the data flash."""

    commands: int  # commands started since power-on
    busy: bool  # a command is in progress
    dead: bool  # power has failed (`Board.cut_flash`): the contents are frozen


def _native_config(ffi: Any, plant: PlantConfig, core: CoreSpeed, seed: int, baud: float) -> Any:
    config = ffi.new("board_config_t *")
    plant.drawn(seed).fill(config)
    config.core.cycles_per_instruction, config.core.entry_cycles = core.cycles_per_instruction, int(core.entry_cycles)
    config.baud, config.seed = baud, seed
    return config


class Board:
    """A virtual board, after power-on.

    Parameters
    ----------
    plant : PlantConfig, optional
        Plant data; the packaged ``plant.toml`` by default.
    seed : int
        Seed of all random numbers of the board, 0 .. 2^64 - 1.
    baud : float
        Speed of the serial line [bit/s], ten bits per byte.
    catalogue : Catalogue, optional
        Table of variables; the packaged one by default.
    level : {"registers", "ideal"}, optional
        Level of detail of chip and plant; by default the environment variable SERVO_TWIN_LEVEL, or else
        ``registers``.
    core : CoreSpeed, optional
        Execution time of the core at level ``registers``; the packaged ``core.toml`` by default.
    servo : ServoConfig, optional
        Configuration of the firmware; that of ``firmware/config/servo.toml``, compiled in, by default.
    flash : bytes, optional
        Contents of the data flash: `flash_image` of another board; erased by default.
    firmware : Firmware, optional
        Another build of firmware, chip and plant; that of `level` by default.
    elf : bytes, optional
        ELF file of the firmware (``make firmware BOARD=mc56f84789_m4``), executed instruction by instruction instead of
        the linked firmware, at level ``registers``; by default that of the environment variable SERVO_TWIN_ELF. `core`
        has no effect then: the instructions take the time.

    Raises
    ------
    BoardError
        If the ELF file is not one of this firmware.
    """

    def __init__(
        self,
        plant: PlantConfig | None = None,
        *,
        seed: int = 0,
        baud: float = 115200.0,
        catalogue: Catalogue | None = None,
        level: Level | None = None,
        core: CoreSpeed | None = None,
        servo: ServoConfig | None = None,
        flash: bytes | None = None,
        firmware: Firmware | None = None,
        elf: bytes | None = None,
    ) -> None:
        if not 0 <= seed < 1 << 64:
            raise ValueError(f"seed {seed} is not within 0 .. 2^64 - 1")
        if not 100.0 <= baud <= 1e8:
            raise ValueError(f"baud {baud} is not within 100 .. 100 million")
        self.level = chosen_level(level)
        self.catalogue = catalogue or Catalogue.load()
        board = self.catalogue.board.name
        self.firmware = firmware or build_of(board, self.level)
        by_default = elf is None and firmware is None and self.level == ELF_LEVEL
        if by_default:
            elf = chosen_elf()
        if elf is None and needs_elf(board, self.level):
            raise BoardError(
                f"no firmware is linked with the model of the board {board} at level registers: "
                f"give its ELF file (make firmware BOARD={board}), or level ideal"
            )
        if elf is not None and self.level != ELF_LEVEL:
            raise ValueError(f"an ELF file runs at level {ELF_LEVEL} only")
        self._elf = elf
        self._ffi, self._lib = self.firmware.ffi, self.firmware.lib
        self.plant = plant or PlantConfig.load()
        self._seed = seed
        config = _native_config(self._ffi, self.plant, core or CoreSpeed.load(), seed, baud)
        if flash is not None:
            size = int(self._lib.board_flash_size())
            if len(flash) != size:
                raise ValueError(f"the flash image has {len(flash)} bytes instead of {size}")
            config.flash = self._ffi.from_buffer("uint8_t[]", flash)  # board_new copies the image
        if servo is not None:
            native = servo.native(self._ffi)  # kept until board_new has copied it
            config.servo = native[0]
        if elf is not None:
            config.elf, config.elf_size = self._ffi.from_buffer("uint8_t[]", elf), len(elf)  # copied, too
        handle = self._lib.board_new(config)
        if handle == self._ffi.NULL:
            raise MemoryError("no memory for another board")
        config.flash = config.servo = config.elf = self._ffi.NULL
        self._config = config
        self._handle: Any = self._ffi.gc(handle, self._lib.board_free)
        self._truth = self._ffi.new("board_truth_t *")
        self._own_memory = BoardMemory(self._ffi, self._lib, self._handle)
        self._dtype: np.dtype[np.void] | None = None
        self._injected: list[InjectedFault] = []
        self._sampler: BoardSampler | None = None
        self._leader: Leader | None = None
        problem = self._lib.board_error(handle)
        if problem != self._ffi.NULL:
            text = self._ffi.string(problem).decode()
            self.close()
            raise BoardError(f"{os.environ[ELF_VARIABLE]}: {text}" if by_default and elf is not None else text)

    # ---- lifetime --------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Free the board; a second call has no effect."""
        if self._handle is not None:
            self._sampler = None
            self._ffi.release(self._handle)
            self._handle = None

    def __enter__(self) -> Board:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _board(self) -> Any:
        if self._handle is None:
            raise BoardError("the board is closed")
        return self._handle

    @property
    def _memory(self) -> BoardMemory:
        if self._handle is None:
            raise BoardError("the board is closed")
        return self._own_memory

    def _check(self) -> None:
        """Raise `ChipError` if the chip has stopped."""
        error = self._lib.board_error(self._board)
        if error != self._ffi.NULL:
            raise ChipError(self._ffi.string(error).decode())

    @property
    def build(self) -> str:
        """SHA-256 of the compiled module, and of the ELF file if there is one: such boards give the same bits."""
        return f"{self.firmware.build}{ELF_MARK}{self.elf_sha256}" if self._elf else self.firmware.build

    @property
    def elf_sha256(self) -> str:
        """SHA-256 of the ELF file that is executed, hexadecimal; empty: none."""
        return hashlib.sha256(self._elf).hexdigest() if self._elf else ""

    # ---- state ------------------------------------------------------------------------------------------------------

    def state(self) -> BoardState:
        """Complete state: firmware, chip, plant, random numbers, flash, bytes on the line, injected faults.

        At level ``registers`` the board first goes on to the end of the running interrupt handlers (less than a PWM
        period), unless it executes an ELF file; `BoardState.time_ns` is that instant.

        Raises
        ------
        BoardError
            If a sampling is active, or at level ``registers`` if the core is overloaded.
        """
        size = self._ffi.new("size_t *")
        self._check_image(self._lib.board_save(self._board, self._ffi.NULL, 0, size))
        image = bytearray(size[0])
        buffer = self._ffi.from_buffer("uint8_t[]", image, require_writable=True)
        self._check_image(self._lib.board_save(self._board, buffer, len(image), size))
        return BoardState(self.level, self.time_ns, self._seed, self.plant, tuple(self._injected), bytes(image))

    def restore(self, state: BoardState) -> None:
        """Continue from a state of any board of the same level: every later bit is that of the other board.

        Raises
        ------
        BoardError
            If the state is from another build or level, or damaged; the board is then unchanged.
        """
        self.end_sampling()
        buffer = self._ffi.from_buffer("uint8_t[]", state.image)
        self._check_image(self._lib.board_restore(self._board, buffer, len(state.image)))
        self.plant, self._seed, self._injected = state.plant, state.seed, list(state.faults)

    def copy(self) -> Board:
        """Another board in the same state (see `state`); each then continues by itself."""
        state = self.state()
        board = Board(
            state.plant,
            seed=state.seed,
            catalogue=self.catalogue,
            level=self.level,
            firmware=self.firmware,
            elf=self._elf,
        )
        board.restore(state)
        return board

    def _check_image(self, problem: Any) -> None:
        if problem != self._ffi.NULL:
            raise BoardError(self._ffi.string(problem).decode())

    # ---- time -----------------------------------------------------------------------------------------------------

    @property
    def time_ns(self) -> int:
        """Simulated time since reset [ns]."""
        return int(self._lib.board_time_ns(self._board))

    def advance(self, until_ns: int) -> None:
        """Run up to and including simulated time `until_ns`; no effect if that is in the past."""
        for end_ns in self._stretches(until_ns):
            self.advance_alone(end_ns)

    def advance_alone(self, until_ns: int) -> None:
        """As `advance`, also beyond a step of the leader (`follow`), which uses this."""
        self._lib.board_advance(self._board, until_ns)
        self._check()

    def follow(self, leader: Leader) -> None:
        """From now on let the time elapse in the steps of another simulator, which moves shafts (`drive_shaft`).

        `state`, `restore` and `copy` are those of the board alone: the leader has its own.
        """
        self._leader = leader

    def _stretches(self, until_ns: int) -> Iterator[int]:
        """Ends of stretches within which nothing acts on the shafts from outside [ns]; the last one is `until_ns`."""
        if self._leader is None:
            yield until_ns
            return
        while self.time_ns < until_ns:
            yield min(self._leader.end_ns(self), until_ns)

    def run(self, seconds: float) -> None:
        """Run for some simulated time [s]."""
        self.advance(self.time_ns + round(seconds * 1e9))

    def clock(self) -> float:
        """Simulated time since reset [s]."""
        return self.time_ns * 1e-9

    wait = run

    def record(self, until_ns: int) -> NDArray[np.void]:
        """As `advance`, and record the snapshot of every slow tick.

        Returns
        -------
        ndarray, shape (ticks,)
            Raw integers; one field per telemetry variable, named as in the catalogue. `si` converts.
        """
        capacity = max(until_ns - self.time_ns, 0) // TICK_NS + 2
        log, rows = np.zeros(capacity, self.snapshot_dtype), 0
        for end_ns in self._stretches(until_ns):
            rest = self._ffi.from_buffer("uint8_t[]", log[rows:], require_writable=True)
            rows += self._lib.board_record(self._board, end_ns, rest, capacity - rows)
            self._check()
        return log[:rows]

    def sample(self, recorder: int, elements: Sequence[tuple[Variable, int]], capacity: int) -> None:
        """Start continuous sampling by a recorder of the firmware, with the next call of its loop.

        Parameters
        ----------
        recorder : int
            0: every PWM period; 1: every slow tick.
        elements : sequence of (Variable, int)
            Variables and element indices, at most 8.
        capacity : int
            Capacity [points]; the newest points are kept.

        Raises
        ------
        BoardError
            If a variable does not exist or cannot be sampled.
        """
        self.end_sampling()
        places = [self.address(variable.name) + k * variable.element_size for variable, k in elements]
        names = (f"{variable.name}[{k}]" for variable, k in elements)
        layout = np.dtype([(name, _element(variable)) for name, (variable, _) in zip(names, elements, strict=True)])
        self._sampler = BoardSampler(self._ffi, self._lib, self._board, recorder, places, layout, capacity)

    def sampled(self) -> NDArray[np.void]:
        """Points since `sample`, oldest first; raw integers, one field per element in the order of `sample`."""
        if self._sampler is None:
            raise BoardError("no sampling is active: call sample first")
        return self._sampler.points()

    def end_sampling(self) -> None:
        """End the sampling that `sample` has started, if any."""
        if self._sampler is not None:
            self._sampler.close()
            self._sampler = None

    def trace(self, until_ns: int, capacity: int = 1_000_000) -> NDArray[np.void]:
        """As `advance`, and record the events of the chip as by a logic analyser.

        A call immediately after the creation of the board includes the boot from power-on.

        Returns
        -------
        ndarray, shape (events,), dtype `TRACE_ENTRY`
            The first `capacity` events; none at level ``ideal``.
        """
        log, size = np.zeros(capacity, TRACE_ENTRY), 0
        for end_ns in self._stretches(until_ns):
            rest = self._ffi.from_buffer("trace_entry_t[]", log[size:], require_writable=True)
            size += self._lib.board_trace(self._board, end_ns, rest, capacity - size)
            self._check()
        seen: NDArray[np.void] = log[:size].copy()
        return seen

    # ---- registers --------------------------------------------------------------------------------------------------

    def peek(self, address: int) -> int:
        """Read a register of the chip, including the side effects of a read.

        Raises
        ------
        ChipError
            If the register does not exist; the board has stopped.
        """
        value = int(self._lib.board_peek(self._board, address))
        self._check_register(value)
        return value

    def poke(self, address: int, value: int) -> None:
        """Write a register of the chip, as a debugger."""
        self._check_register(int(self._lib.board_poke(self._board, address, value & 0xFFFF)))

    def _check_register(self, result: int) -> None:
        self._check()
        if result < 0:
            raise BoardError("a board at level 'ideal' has no registers")

    @property
    def snapshot_dtype(self) -> np.dtype[np.void]:
        """Layout of one snapshot, from the addresses in the table of the board."""
        if self._dtype is None:
            variables = self.catalogue.snapshot_variables()
            start = self.address("snapshot")
            self._dtype = np.dtype(
                {
                    "names": [v.name for v in variables],
                    "formats": [_format(v) for v in variables],
                    "offsets": [self.address(v.name) - start for v in variables],
                    "itemsize": int(self._lib.board_snapshot_size()),
                }
            )
        return self._dtype

    def si(self, log: NDArray[np.void]) -> Trace:
        """Successive recorded snapshots in SI, by catalogue name; `Trace.time` is the time since reset."""
        columns = {name: log[name] * float(self.catalogue[name].lsb) for name in log.dtype.names or ()}
        first = int(log["tick"][0]) // SLOW_PERIODS if log.size else 0
        return Trace(TICK, columns, first)

    # ---- firmware variables -----------------------------------------------------------------------------------------

    @property
    def addresses(self) -> Mapping[str, int]:
        """Address of every variable in the table of the board."""
        return {name: entry.address for name, entry in self._memory.variables.items()}

    def address(self, name: str) -> int:
        """Address of one variable.

        Raises
        ------
        BoardError
            If the variable does not exist.
        """
        try:
            return self._memory.variables[name].address
        except KeyError:
            raise BoardError(f"the board has no variable {name!r}") from None

    def read(self, name: str) -> Value:
        """Value of a variable in SI units; a list for arrays."""
        variable = self.catalogue[name]
        return variable.decode(self._read_variable(variable))

    def write(self, name: str, value: float | Sequence[float]) -> None:
        """Write a variable in SI units, with the checks of the FreeMASTER server but without the serial line.

        Raises
        ------
        ValueError
            If the value is outside the limits of the variable.
        BoardError
            If the board refuses.
        """
        self._write_bytes(name, self.catalogue[name].encode(value))

    def read_words(self, name: str) -> list[int]:
        """Raw integers of a variable, one per element."""
        variable = self.catalogue[name]
        return variable.decode_raw(self._read_variable(variable))

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        """Write raw integers from element `first` on in one access; False if the board refuses them as out of range.

        Raises
        ------
        ValueError
            If an element does not exist.
        BoardError
            If the board refuses for another reason.
        """
        offset, data = self.catalogue[name].encode_part(words, first)
        try:
            self.write_memory(self.address(name) + offset, data)
        except BoardError as error:
            if error.status != OUT_OF_RANGE:
                raise BoardError(f"{name}: {error}", error.status) from None
            return False
        return True

    def write_raw(self, name: str, raw: int | Sequence[int]) -> None:
        """Write the raw integers of a variable, one per element."""
        values = [raw] if isinstance(raw, int) else list(raw)
        self._write_bytes(name, self.catalogue[name].encode_raw(values))

    def read_memory(self, address: int, size: int) -> bytes:
        """Read bytes at an address, as FreeMASTER READMEM.

        Raises
        ------
        BoardError
            If the board refuses; `BoardError.status` is the reason.
        """
        return self._memory.read(address, size)

    def write_memory(self, address: int, data: bytes) -> None:
        """Write bytes at an address, as FreeMASTER WRITEMEM."""
        self._memory.write(address, data)

    def _read_variable(self, variable: Variable) -> bytes:
        address = self.address(variable.name)
        return self.read_memory(address, variable.size or self._memory.variables[variable.name].size)

    def _write_bytes(self, name: str, data: bytes) -> None:
        try:
            self.write_memory(self.address(name), data)
        except BoardError as error:
            raise BoardError(f"{name}: {error}", error.status) from None

    # ---- serial line ------------------------------------------------------------------------------------------------

    def serial_in(self, data: bytes) -> int:
        """Send bytes to the board; returns the number of accepted bytes."""
        return int(self._lib.board_serial_in(self._board, data, len(data)))

    def serial_out(self) -> bytes:
        """Read all bytes received from the board."""
        capacity = 4096
        buffer = self._ffi.new("uint8_t[]", capacity)
        parts: list[bytes] = []
        while True:
            size = int(self._lib.board_serial_out(self._board, buffer, capacity))
            parts.append(bytes(self._ffi.buffer(buffer, size)))
            if size < capacity:
                return b"".join(parts)

    def serial_next_ns(self) -> int | None:
        """Simulated time of the end of the next byte on the line [ns]; None while the line is idle."""
        next_ns = int(self._lib.board_serial_next_ns(self._board))
        return None if next_ns == _IDLE else next_ns

    # ---- data flash -------------------------------------------------------------------------------------------------

    def flash_image(self) -> bytes:
        """Non-volatile memory: words of the data flash, and erase counts of the sectors.

        ``np.frombuffer(image, "<u4")`` has 8192 words and 32 counts.
        """
        image = bytearray(int(self._lib.board_flash_size()))
        self._lib.board_flash_image(self._board, self._ffi.from_buffer("uint8_t[]", image, require_writable=True))
        return bytes(image)

    def flash_state(self) -> FlashState:
        """State of the data flash."""
        state = self._ffi.new("board_flash_state_t *")
        self._lib.board_flash_state(self._board, state)
        return FlashState(state.commands, bool(state.busy), bool(state.dead))

    def cut_flash(self, number: int, part: float) -> None:
        """Simulate a power failure during a future command of the flash.

        The board continues, but the contents of the flash are frozen: `flash_image` is for the next board.

        Parameters
        ----------
        number : int
            Number of the command; 1: the next one.
        part : float
            Elapsed fraction of the command at the power failure, 0 .. 1.
        """
        self._lib.board_flash_cut(self._board, number, part)

    def cut_power(self) -> bytes:
        """Simulate a power failure now and return the flash image. A command in progress is left incomplete."""
        self._lib.board_flash_cut_now(self._board)
        return self.flash_image()

    # ---- plant ------------------------------------------------------------------------------------------------------

    def truth(self, axis: int) -> Truth:
        """True state of the plant of an axis (index 0 or 1)."""
        return Truth._make(_truth_values(self._read_truth(axis)))

    def impulse(self, axis: int) -> float:
        """`Truth.impulse_e` alone [N m s]: a coupled simulator reads it twice in every step."""
        return float(self._read_truth(axis).impulse_e)

    def _read_truth(self, axis: int) -> Any:
        self._lib.board_truth(self._board, _axis_index(axis), self._truth)
        return self._truth

    def stats(self) -> BoardStats:
        """Counters of the chip."""
        stats = self._ffi.new("board_stats_t *")
        self._lib.board_stats(self._board, stats)
        return BoardStats(**{name: getattr(stats, name) for name in BoardStats.__dataclass_fields__})

    def inject(self, fault: InjectedFault) -> None:
        """Inject a fault from now on (`servo_twin.fault_injection`); `plant` remains that without the fault."""
        if isinstance(fault, ChangedValue):
            fault.applied(self.plant)  # raises on an invalid value before any change
            self._injected.append(fault)
            self._change_plant()
            return
        self._lib.board_inject_fault(self._board, self._raw(fault))
        self._injected.append(fault)

    def clear_fault(self, fault: InjectedFault | None = None) -> None:
        """Remove an injected fault; by default all."""
        faults = self._injected if fault is None else [fault]
        for one in reversed(faults):
            if not isinstance(one, ChangedValue):
                self._lib.board_clear_fault(self._board, self._raw(one))
        changed = any(isinstance(one, ChangedValue) for one in faults)
        self._injected = [one for one in self._injected if one not in faults]
        if changed:
            self._change_plant()

    def _raw(self, fault: NativeFault) -> Any:
        kind, *where = fault.raw()
        return self._ffi.new("board_fault_t *", (getattr(self._lib, kind), *where))

    def set_plant(self, name: str, value: float) -> None:
        """Change a value of the plant [SI] by its name in the plant file: ``axis1.r_s``, ``bus.u_source``.

        Currents, speeds, angles and temperatures are continuous; `plant` is the new plant.

        Raises
        ------
        PlantError
            If the name is unknown or in `servo_twin.plant.FIXED_NAMES`, or the value is invalid.
        """
        if name.rpartition(".")[2] in FIXED_NAMES:
            raise PlantError(f"{name}: cannot be changed on a running board; create a new board")
        self.take_plant(self.plant.with_value(name, value))

    def take_plant(self, plant: PlantConfig) -> None:
        """As `set_plant`, with all values at once; the values of `servo_twin.plant.FIXED_NAMES` must not change."""
        self.plant = plant
        self._change_plant()

    def _change_plant(self) -> None:
        plant = self.plant
        for fault in self._injected:
            plant = fault.applied(plant) if isinstance(fault, ChangedValue) else plant
        plant.drawn(self._seed).fill(self._config)
        self._lib.board_change_plant(self._board, self._config)

    def set_load(self, axis: int, torque: float) -> None:
        """Set the external torque, which opposes positive motion [N m]."""
        self.plant = self.plant.with_axis(_axis_index(axis), load_torque=torque)
        self._lib.board_set_load(self._board, axis, torque)

    def set_supply(self, volts: float) -> None:
        """Set the open-circuit voltage of the supply [V]."""
        self.plant = self.plant.with_bus(u_source=volts)
        self._lib.board_set_supply(self._board, volts)

    def brown_out(self, seconds: float) -> None:
        """Let the supply of the chip fall below its reset level for some time [s]; that of the bus does not.

        Registers and memory are lost, and the pins are inputs; then the software starts as at power-on.

        Raises
        ------
        ValueError
            If the time is negative or not finite.
        BoardError
            If it is not modelled: only a board odrive36 that executes an ELF file has it.
        """
        if not 0.0 <= seconds < math.inf:
            raise ValueError(f"brown-out of {seconds} s: the time must be finite and at least 0")
        problem = self._lib.board_brown_out(self._board, seconds)
        self._check()
        self._check_image(problem)

    def lock_shaft(self, axis: int, locked: bool = True) -> None:
        """Lock or release the shaft of an axis."""
        self._lib.board_set_shaft(self._board, _axis_index(axis), int(locked))

    def obstruct_shaft(self, axis: int, below: float, above: float) -> None:
        """Set end stops at these distances from the present angle of the shaft [rad]; infinite: none.

        Raises
        ------
        BoardError
            If a distance is no number.
        """
        index = _axis_index(axis)
        if math.isnan(below) or math.isnan(above):
            raise BoardError(
                f"{axis_name(axis)}: end stops {below:g} and {above:g} rad; write distances, or inf for none"
            )
        self._lib.board_obstruct_shaft(self._board, index, below, above)

    def drive_shaft(self, axis: int, theta: float, omega: float, seconds: float) -> None:
        """Move the shaft to an angle and a speed from outside: another simulator owns its inertia (doc/coupling.md).

        From now on load, friction, end stops and cogging of the plant have no effect on this axis. The mean air-gap
        torque of the step is the difference of `Truth.impulse_e` over its time; the other simulator adds
        `brake_torque`.

        Parameters
        ----------
        axis : int
            Index of the axis.
        theta, omega : float
            Mechanical angle [rad] and speed [rad/s] at the end; between, the motion is a cubic.
        seconds : float
            Duration of the motion [s], at level ``ideal`` a multiple of half the PWM period. The speed is kept
            afterwards.

        Raises
        ------
        BoardError
            If the motion is not finite or too fast, or the axis has a second mass.
        """
        problem = self._lib.board_drive_shaft(self._board, _axis_index(axis), theta, omega, seconds)
        if problem != self._ffi.NULL:
            raise BoardError(f"{axis_name(axis)}: {self._ffi.string(problem).decode()}")

    def brake_torque(self, axis: int, inertia: float, seconds: float) -> float:
        """Torque of the holding brake on a driven shaft in the next step of the other simulator [N m].

        To be called once per step, at the end of the motion. The brake holds the shaft like a stiff spring with a
        damper, which slips at the torque in the plant file; 0 while it is open.

        Parameters
        ----------
        axis : int
            Index of the axis.
        inertia : float
            Inertia of all that the shaft moves, at the shaft [kg m^2].
        seconds : float
            Duration of the step [s].

        Raises
        ------
        BoardError
            If inertia or duration are not above 0, or not finite.
        """
        index = _axis_index(axis)
        if not (0.0 < inertia < math.inf and 0.0 < seconds < math.inf):
            raise BoardError(f"{axis_name(axis)}: {inertia:g} kg m^2 in {seconds:g} s; both are above 0 and finite")
        return float(self._lib.board_brake_torque(self._board, index, inertia, seconds))

    def pins(self, axis: int) -> frozenset[Pin]:
        """Pins that the firmware uses; all of them if another program runs."""
        bits = self._lib.board_pins(self._board, _axis_index(axis))
        return frozenset(pin for k, pin in enumerate(PINS) if bits >> k & 1)

    def release_shaft(self, axis: int) -> None:
        """End `drive_shaft`: the board owns the shaft again, with its present motion."""
        self._lib.board_release_shaft(self._board, _axis_index(axis))

    def connect_encoder(self, axis: int, connected: bool = True) -> None:
        """Connect or disconnect the encoder of an axis."""
        self._lib.board_set_encoder(self._board, _axis_index(axis), int(connected))

    def cut_encoder_line(self, axis: int, line: Literal["A", "B"]) -> None:
        """Interrupt one line of the encoder of an axis; `connect_encoder` restores it."""
        self._lib.board_cut_encoder(self._board, _axis_index(axis), "AB".index(line))

    def reverse_encoder(self, axis: int) -> None:
        """Swap the lines A and B of the encoder of an axis."""
        self._lib.board_reverse_encoder(self._board, _axis_index(axis))

    def set_winding(self, axis: int, celsius: float) -> None:
        """Set the temperature of a winding and the estimate of the firmware [deg C].

        Raises
        ------
        ValueError
            If the value is outside the range of the variable.
        BoardError
            With status `BUSY`, while an executed program starts after a reset; nothing is set.
        """
        self._set_winding(self._lib.board_set_winding, axis, celsius)

    def set_magnet(self, axis: int, celsius: float) -> None:
        """Set the temperature of a magnet [deg C]; it then follows the winding with time constant `magnet_time`."""
        self._lib.board_set_magnet(self._board, _axis_index(axis), celsius)

    def set_winding_estimate(self, axis: int, celsius: float) -> None:
        """Set the estimate of the firmware, not the temperature of the motor [deg C]; errors: see `set_winding`."""
        self._set_winding(self._lib.board_set_winding_estimate, axis, celsius)

    def _set_winding(self, take: Any, axis: int, celsius: float) -> None:
        span = self.catalogue[f"{axis_name(axis)}.winding_temperature"]
        if not span.minimum <= celsius <= span.maximum:
            raise ValueError(f"{celsius:g} deg C is not within {span.minimum:g} .. {span.maximum:g}")
        if status := take(self._board, _axis_index(axis), celsius):
            raise BoardError(f"winding temperature of axis {axis}: {status_text(status)}", status)

    def connect_motor(self, axis: int, connected: bool = True) -> None:
        """Connect or disconnect the motor cable of an axis."""
        self._lib.board_set_motor(self._board, _axis_index(axis), int(connected))


def _format(variable: Variable) -> str:
    """Numpy format of a variable."""
    shape = f"{variable.count}" if variable.count > 1 else ""
    return f"{shape}{_element(variable)}"


def _element(variable: Variable) -> str:
    """Numpy format of one element of a variable."""
    return f"<{'i' if variable.format.signed else 'u'}{variable.element_size}"


def _axis_index(axis: int) -> int:
    if not 0 <= axis < AXES:
        raise IndexError(f"axis {axis}: a board has the axes 0 .. {AXES - 1}")
    return axis
