"""A virtual board on the bench: what a host may do over the serial line, and what may happen to the plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Final

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.commands import Request
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_twin.board_memory import BoardMemory
from servo_twin.fault_injection import NativeFault
from servo_twin.plant import PlantConfig

BAUD: Final = 1_000_000.0

_IDLE: Final = (1 << 64) - 1
_STEP: Final = 0.0025
"""Time between two looks at a condition [s]."""

_HEARTBEAT: Final = 0.2
"""Longest time in which a host that waits says nothing [s]; the firmware stops for one that has fallen silent."""


class RigError(AssertionError):
    """The board did not do what a scenario waits for."""


class Rig:
    """A board that has just been switched on.

    Commands go over the serial line, because that is part of what is recorded. `get` looks at variables past it, which
    changes nothing.

    Parameters
    ----------
    ffi, lib : cffi library
        The virtual board (``board.h``) with the recorder (``recorder.h``).
    plant : PlantConfig
        What is really there.
    seed : int
        Of every random number of the board.

    Attributes
    ----------
    catalogue : Catalogue
        Of the board's variables.
    entries : sequence of str
        Names of the entries in the table of variables.
    written : list of (str, tuple of int)
        Variables that were written, and the raw numbers.
    """

    def __init__(self, ffi: Any, lib: Any, plant: PlantConfig, seed: int) -> None:
        self._ffi, self._lib = ffi, lib
        self.catalogue = Catalogue.load()
        config = ffi.new("board_config_t *")
        plant.fill(config)
        config.baud, config.seed = BAUD, seed
        self._board = lib.board_new(config)
        self._memory = BoardMemory(ffi, lib, self._board)
        self.entries: Sequence[str] = [entry.name for entry in self._memory.table]
        self._spoken_ns = 0
        self.written: list[tuple[str, tuple[int, ...]]] = []

    def __enter__(self) -> Rig:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lib.board_free(self._board)

    # ---- time -----------------------------------------------------------------------------------------------------

    def run(self, seconds: float) -> None:
        """Let simulated time pass [s]."""
        self._lib.board_advance(self._board, self._now_ns() + round(seconds * 1e9))

    def until(self, what: str, condition: Callable[[], bool], within: float = 3.0, silent: bool = False) -> None:
        """Run until a condition holds.

        Parameters
        ----------
        within : float
            Time-out [s of simulated time].
        silent : bool
            Say nothing meanwhile.

        Raises
        ------
        RigError
            If it does not hold in time.
        """
        for _ in range(round(within / _STEP)):
            if condition():
                return
            if not silent and self._now_ns() - self._spoken_ns > _HEARTBEAT * 1e9:
                self.command("KEEP_ALIVE")
            self.run(_STEP)
        axes = "; ".join(f"axis{k + 1} {place} {self.faults(k)}" for k, place in enumerate(self.places()))
        raise RigError(f"not within {within:g} s: {what}; {axes}")

    def _now_ns(self) -> int:
        return int(self._lib.board_time_ns(self._board))

    # ---- the serial line --------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Put bytes on the line and wait until the answer, if there is one, has passed."""
        if self._lib.board_serial_in(self._board, data, len(data)) != len(data):
            raise RigError("the serial line does not take more bytes")
        while (next_ns := int(self._lib.board_serial_next_ns(self._board))) != _IDLE:
            self._lib.board_advance(self._board, next_ns)
        self._spoken_ns = self._now_ns()

    def request(self, request: Request) -> None:
        """Send one FreeMASTER request."""
        self.send(request.frame)

    def command(self, name: str) -> None:
        """Run an application command."""
        self.request(commands.send_command(self.catalogue.bits["command"][name]))
        self.request(commands.get_command_status())

    def set(self, name: str, *values: float) -> None:
        """Write a variable in SI units: one value per element, or one for all."""
        variable = self.catalogue[name]
        self.set_raw(name, *map(variable.to_raw, values * variable.count if len(values) == 1 else values))

    def set_raw(self, name: str, *raw: int) -> None:
        """Write the raw numbers of a variable; the board refuses those outside its range."""
        self.request(commands.write_memory(self.address(name), self.catalogue[name].encode_raw(raw)))
        self.written.append((name, raw))

    def points(self, *points: TimedPoint) -> None:
        """Write timed points; the board may refuse them."""
        words = encode_points(self.catalogue, points)
        self.words(*words)

    def words(self, *words: int) -> None:
        """Write the first words of timed points, whole ones or not."""
        data = b"".join(word.to_bytes(4, "little", signed=True) for word in words)
        self.request(commands.write_memory(self.address("cmd.points"), data))
        self.written.append(("cmd.points", words))

    def points_together(self, *writes: Sequence[TimedPoint]) -> None:
        """Write timed points with nothing between the requests."""
        frames = b""
        for points in writes:
            data = b"".join(word.to_bytes(4, "little", signed=True) for word in encode_points(self.catalogue, points))
            frames += commands.write_memory(self.address("cmd.points"), data).frame
        self.send(frames)

    # ---- looking ----------------------------------------------------------------------------------------------------

    def address(self, name: str) -> int:
        return self._memory.variables[name].address

    def get(self, name: str) -> float:
        """Value of a scalar in SI units."""
        variable = self.catalogue[name]
        value = variable.decode(self._memory.read(self.address(name), variable.size))
        if not isinstance(value, (int, float)):
            raise RigError(f"{name} is not a scalar")
        return value

    def raw(self, name: str) -> list[int]:
        """Raw numbers of a variable."""
        variable = self.catalogue[name]
        return variable.decode_raw(self._memory.read(self.address(name), variable.size))

    def places(self) -> list[str]:
        """Where both axes are: the sub-state in RUN, else the state."""
        return [self._place(f"axis{k}") for k in (1, 2)]

    def _place(self, axis: str) -> str:
        state = self.catalogue.label("state_t", round(self.get(f"{axis}.state")))
        substate = self.catalogue.label("substate_t", round(self.get(f"{axis}.substate")))
        return substate if state == "RUN" else state

    def faults(self, axis: int) -> list[str]:
        """Names of the faults of an axis (0 or 1)."""
        return [flag.name for flag in self.catalogue.active("faults", round(self.get(f"axis{axis + 1}.faults")))]

    # ---- the plant --------------------------------------------------------------------------------------------------

    def load(self, axis: int, torque: float) -> None:
        """External torque on an axis [N m]."""
        self._lib.board_set_load(self._board, axis, torque)

    def supply(self, volts: float) -> None:
        """Open-circuit voltage of the supply [V]."""
        self._lib.board_set_supply(self._board, volts)

    def lock(self, axis: int, locked: bool = True) -> None:
        """Hold a shaft fast, or let it go."""
        self._lib.board_set_shaft(self._board, axis, int(locked))

    def obstruct(self, axis: int, below: float, above: float) -> None:
        """End stops so far from where a shaft is [rad]."""
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
        """Break something."""
        self._lib.board_inject_fault(self._board, self._raw(fault))

    def clear_fault(self, fault: NativeFault) -> None:
        """Make it whole again."""
        self._lib.board_clear_fault(self._board, self._raw(fault))

    def _raw(self, fault: NativeFault) -> Any:
        kind, *where = fault.raw()
        return self._ffi.new("board_fault_t *", (getattr(self._lib, kind), *where))

    def disturb(self, *axes: int, one_in: int, seed: int = 1) -> None:
        """Replace one in so many analogue inputs and edges of some axes (0, 1) by random ones."""
        self._lib.record_disturb(sum(1 << axis for axis in axes), one_in, seed)

    def calm(self) -> None:
        """End the disturbance."""
        self._lib.record_disturb(0, 0, 0)

    def lose_index(self, lost: bool) -> None:
        """Let the index counters of both encoders stand still, or go on."""
        self._lib.record_lose_index(lost)
