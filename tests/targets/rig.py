"""Test rig: a virtual board with a host on its serial line and disturbances of its plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Final

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.commands import Request
from servo_msgs_py.board_port import place, reached, word
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_twin.board_memory import BoardMemory
from servo_twin.fault_injection import NativeFault
from servo_twin.plant import PlantConfig

BAUD: Final = 1_000_000.0

_IDLE: Final = (1 << 64) - 1
_STEP: Final = 0.0025
"""Period of the test of a condition [s]."""

_HEARTBEAT: Final = 0.2
"""Period of keep-alives while the host waits [s], below the host time-out of the firmware."""


class RigError(AssertionError):
    """The board did not reach the state that a scenario requires."""


class Rig:
    """A board after power-on.

    Commands use the serial line, which is part of the recording. `get` reads the memory directly, without an effect on
    the recording.

    Parameters
    ----------
    ffi, lib : cffi library
        The virtual board (``board.h``) with the recorder (``recorder.h``).
    plant : PlantConfig
        Plant data.
    seed : int
        Seed of all random numbers of the board.
    """

    def __init__(self, ffi: Any, lib: Any, plant: PlantConfig, seed: int) -> None:
        self._ffi, self._lib = ffi, lib
        self.catalogue = Catalogue.load()
        config = ffi.new("board_config_t *")
        plant.fill(config)
        config.baud, config.seed = BAUD, seed
        self._board = lib.board_new(config)
        self._memory = BoardMemory(ffi, lib, self._board)
        # names of the entries in the table of variables
        self.entries: Sequence[str] = [entry.name for entry in self._memory.table]
        self._sent_ns = 0
        self._silent = False  # the present wait sends no keep-alives

    def __enter__(self) -> Rig:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lib.board_free(self._board)

    # ---- time -----------------------------------------------------------------------------------------------------

    def run(self, seconds: float) -> None:
        """Advance simulated time [s]."""
        self._lib.board_advance(self._board, self._now_ns() + round(seconds * 1e9))

    def until(self, what: str, condition: Callable[[], bool], within: float = 3.0, silent: bool = False) -> None:
        """Run until a condition holds.

        Parameters
        ----------
        within : float
            Time-out in simulated time [s].
        silent : bool
            True: send no keep-alives.

        Raises
        ------
        RigError
            If it does not hold in time.
        """
        self._silent = silent
        holds = reached(self, condition, within, _STEP)
        self._silent = False
        if holds:
            return
        axes = "; ".join(f"axis{k + 1} {state} {self.faults(k)}" for k, state in enumerate(self.states()))
        raise RigError(f"not within {within:g} s: {what}; {axes}")

    def clock(self) -> float:
        """Simulated time [s]."""
        return self._now_ns() * 1e-9

    def wait(self, seconds: float) -> None:
        """Advance simulated time [s] after a keep-alive, if one is due."""
        if not self._silent and self._now_ns() - self._sent_ns > _HEARTBEAT * 1e9:
            self.command("KEEP_ALIVE")
        self.run(seconds)

    def _now_ns(self) -> int:
        return int(self._lib.board_time_ns(self._board))

    # ---- the serial line --------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Send bytes and wait for the end of the answer, if any."""
        if self._lib.board_serial_in(self._board, data, len(data)) != len(data):
            raise RigError("the serial line does not take more bytes")
        while (next_ns := int(self._lib.board_serial_next_ns(self._board))) != _IDLE:
            self._lib.board_advance(self._board, next_ns)
        self._sent_ns = self._now_ns()

    def request(self, request: Request) -> None:
        """Send one FreeMASTER request."""
        self.send(request.frame)

    def command(self, name: str) -> None:
        """Run an application command."""
        self.request(commands.send_command(self.catalogue.bits["command"][name]))
        self.request(commands.get_command_status())

    def set(self, name: str, *values: float) -> None:
        """Write a variable in SI units: one value per element, or one for all elements."""
        variable = self.catalogue[name]
        self.set_raw(name, *map(variable.to_raw, values * variable.count if len(values) == 1 else values))

    def set_raw(self, name: str, *raw: int) -> None:
        """Write the raw numbers of a variable; the board refuses those outside its range."""
        self.request(commands.write_memory(self.address(name), self.catalogue[name].encode_raw(raw)))

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        """Write elements of a variable of the configuration; False if the board refuses them."""
        variable = self.catalogue[name]
        address = self.address(name) + first * variable.element_size
        self.request(commands.write_memory(address, variable.pack(words)))
        return self.read_words("config.refusal") == [0]

    def points(self, *points: TimedPoint) -> None:
        """Write timed points; the answer is not checked."""
        words = encode_points(self.catalogue, points)
        self.words(*words)

    def words(self, *words: int) -> None:
        """Write words of timed points, complete points or not."""
        data = b"".join(word.to_bytes(4, "little", signed=True) for word in words)
        self.request(commands.write_memory(self.address("cmd.points"), data))

    def together(self, *writes: tuple[str, Sequence[int]]) -> None:
        """Send several writes of raw numbers without a pause."""
        frames = (commands.write_memory(self.address(name), self.catalogue[name].pack(words)) for name, words in writes)
        self.send(b"".join(frame.frame for frame in frames))

    # ---- reading ----------------------------------------------------------------------------------------------------

    def address(self, name: str) -> int:
        return self._memory.variables[name].address

    def get(self, name: str) -> float:
        """Value of a scalar in SI units."""
        variable = self.catalogue[name]
        value = variable.decode(self._memory.read(self.address(name), variable.size))
        if not isinstance(value, (int, float)):
            raise RigError(f"{name} is not a scalar")
        return value

    def read_words(self, name: str) -> list[int]:
        """Raw numbers of a variable."""
        variable = self.catalogue[name]
        return variable.decode_raw(self._memory.read(self.address(name), variable.size))

    def states(self) -> list[str]:
        """State of both axes: the sub-state in RUN, else the state."""
        return [place(self, axis) for axis in range(AXES)]

    def faults(self, axis: int) -> list[str]:
        """Names of the faults of an axis (0 or 1)."""
        return [flag.name for flag in self.catalogue.active("faults", word(self, axis, "faults"))]

    # ---- the plant --------------------------------------------------------------------------------------------------

    def load(self, axis: int, torque: float) -> None:
        """External torque on an axis [N m]."""
        self._lib.board_set_load(self._board, axis, torque)

    def supply(self, volts: float) -> None:
        """Open-circuit voltage of the supply [V]."""
        self._lib.board_set_supply(self._board, volts)

    def lock(self, axis: int, locked: bool = True) -> None:
        """Lock or release a shaft."""
        self._lib.board_set_shaft(self._board, axis, int(locked))

    def obstruct(self, axis: int, below: float, above: float) -> None:
        """Set end stops at distances from the present position of a shaft [rad]."""
        self._lib.board_obstruct_shaft(self._board, axis, below, above)

    def plug(self, axis: int, connected: bool) -> None:
        """Connect or disconnect an encoder."""
        self._lib.board_set_encoder(self._board, axis, int(connected))

    def reverse(self, axis: int) -> None:
        """Swap the lines of an encoder."""
        self._lib.board_reverse_encoder(self._board, axis)

    def motor(self, axis: int, connected: bool) -> None:
        """Connect or disconnect the cable of a motor."""
        self._lib.board_set_motor(self._board, axis, int(connected))

    def inject(self, fault: NativeFault) -> None:
        """Inject a fault."""
        self._lib.board_inject_fault(self._board, self._raw(fault))

    def clear_fault(self, fault: NativeFault) -> None:
        """Remove an injected fault."""
        self._lib.board_clear_fault(self._board, self._raw(fault))

    def _raw(self, fault: NativeFault) -> Any:
        kind, *where = fault.raw()
        return self._ffi.new("board_fault_t *", (getattr(self._lib, kind), *where))

    def disturb(self, *axes: int, one_in: int, seed: int = 1) -> None:
        """Replace one in `one_in` analogue inputs and edges of some axes (0, 1) by random values."""
        self._lib.record_disturb(sum(1 << axis for axis in axes), one_in, seed)

    def end_disturbance(self) -> None:
        """End the disturbance."""
        self._lib.record_disturb(0, 0, 0)

    def lose_index(self, lost: bool) -> None:
        """Stop or release the index counters of both encoders."""
        self._lib.record_lose_index(lost)
