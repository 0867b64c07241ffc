"""Test rig: a virtual board with a host on its serial line and disturbances of its plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.commands import Request
from servo_msgs_py.board_port import place, reached, word
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_twin.board import Board, Firmware
from servo_twin.plant import PlantConfig

BAUD: Final = 1_000_000.0

_STEP: Final = 0.0025
"""Period of the test of a condition [s]."""

_HEARTBEAT: Final = 0.2
"""Period of keep-alives while the host waits [s], below the host time-out of the firmware."""


class RigError(AssertionError):
    """The board did not reach the state that a scenario requires."""


class Rig(Board):
    """A board after power-on.

    `set`, `write_words` and the commands use the serial line, which is part of the recording. Reading uses the memory
    directly, without an effect on the recording.

    Parameters
    ----------
    firmware : Firmware
        The virtual board (``board.h``) with the recorder (``recorder.h``).
    plant : PlantConfig
        Plant data.
    seed : int
        Seed of all random numbers of the board.
    """

    def __init__(self, firmware: Firmware, plant: PlantConfig, seed: int) -> None:
        super().__init__(plant, seed=seed, baud=BAUD, level="ideal", firmware=firmware)
        # names of the entries in the table of variables
        self.entries: Sequence[str] = [entry.name for entry in self._memory.table]
        self._sent_ns = 0
        self._silent = False  # the present wait sends no keep-alives

    # ---- time -----------------------------------------------------------------------------------------------------

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

    def wait(self, seconds: float) -> None:
        """Advance simulated time [s] after a keep-alive, if one is due."""
        if not self._silent and self.time_ns - self._sent_ns > _HEARTBEAT * 1e9:
            self.command("KEEP_ALIVE")
        self.run(seconds)

    # ---- the serial line --------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Send bytes and wait for the end of the answer, if any."""
        if self.serial_in(data) != len(data):
            raise RigError("the serial line does not take more bytes")
        while (next_ns := self.serial_next_ns()) is not None:
            self.advance(next_ns)
        self._sent_ns = self.time_ns

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

    def get(self, name: str) -> float:
        """Value of a scalar in SI units."""
        value = self.read(name)
        if not isinstance(value, (int, float)):
            raise RigError(f"{name} is not a scalar")
        return value

    def states(self) -> list[str]:
        """State of both axes: the sub-state in RUN, else the state."""
        return [place(self, axis) for axis in range(AXES)]

    def faults(self, axis: int) -> list[str]:
        """Names of the faults of an axis (0 or 1)."""
        return [flag.name for flag in self.catalogue.active("faults", word(self, axis, "faults"))]

    # ---- disturbances -----------------------------------------------------------------------------------------------

    def disturb(self, *axes: int, one_in: int, seed: int = 1) -> None:
        """Replace one in `one_in` analogue inputs and edges of some axes (0, 1) by random values."""
        self._lib.record_disturb(sum(1 << axis for axis in axes), one_in, seed)

    def end_disturbance(self) -> None:
        """End the disturbance."""
        self._lib.record_disturb(0, 0, 0)

    def lose_index(self, lost: bool) -> None:
        """Stop or release the index counters of both encoders."""
        self._lib.record_lose_index(lost)
