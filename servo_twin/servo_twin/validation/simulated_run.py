"""A recorded run in simulated time: a virtual board, and the messages that the bridge publishes of it, in a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.blocks_message import blocks_message
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.convert import AppliedCommand, applied_message, parameters_message, snapshot_message
from servo_msgs_py.run_file.definitions import encoded
from servo_msgs_py.run_file.run_info import RunInfo, VirtualBoard
from servo_msgs_py.run_file.topic import Topic, type_of
from servo_msgs_py.run_file.writer import RunWriter
from servo_msgs_py.units import PERIOD_NS
from std_msgs.msg import String

from servo_msgs_py import topics
from servo_twin.board import Board
from servo_twin.diagnosis.board_pair import COLUMNS, SampledBoard
from servo_twin.lockstep.twin import Pair
from servo_twin.servo_config import ServoConfig, servo_table

EPOCH_NS: Final = 1_790_000_000_000_000_000
"""Time of the reset of the board [ns]."""

_FLUSH: Final = 1 << 12  # samples


class SimulatedRun(SampledBoard):
    """A board whose run is recorded from its reset.

    Parameters
    ----------
    path : Path
        Must not exist.
    board : Board
        After power-on.
    seed : int
        Of the board; also of the times of the samples.
    loss : float
        Fraction of lost samples, 0 .. 1.
    servo : ServoConfig, optional
        Configuration that is recorded; by default that of the checkout.
    info : bool
        Whether the recording says what ran.
    without : sequence of str
        Relative names of topics that are not recorded.
    """

    def __init__(
        self,
        path: Path,
        board: Board,
        *,
        seed: int,
        loss: float = 0.0,
        servo: ServoConfig | None = None,
        info: bool = True,
        without: Sequence[str] = (),
    ) -> None:
        super().__init__(board, seed=seed, loss=loss)
        self._writer = RunWriter(path)
        self._without = without
        self._count = 0
        self.jump_ns = 0
        """Added to the clock of the recording [ns]."""
        if info:
            virtual = VirtualBoard(level=board.level, seed=seed, plant=board.plant.text(), build=board.build)
            document = RunInfo(catalogue=f"{board.catalogue.hash:08X}", tick_ns=PERIOD_NS, virtual_board=virtual)
            self._write(topics.RUN_INFO, String(data=document.text()), latched=True)
        self.report_parameters()
        table, chosen = AxisConfigTable.load(), servo or ServoConfig.of_table(servo_table())
        self._write(topics.TUNING, blocks_message([table.block(words) for words in chosen.blocks]), latched=True)

    def report_parameters(self) -> None:
        """Record the parameters of the board, as the bridge does after it has written some."""
        present = {v.name: self.board.read_words(v.name) for v in parameters(self.board.catalogue)}
        self._write(topics.PARAMETERS, parameters_message(present, self.board.catalogue), latched=True)

    def close(self) -> None:
        self._writer.close()
        super().close()

    def on_command(self, command: AppliedCommand) -> None:
        self._write(topics.COMMANDS_APPLIED, applied_message(command))

    def on_sample(self, row: Sequence[float]) -> list[Pair]:
        values = [*row[:-2], *divmod(self._now(), 1_000_000_000)]
        self._write(topics.SNAPSHOT, snapshot_message(COLUMNS, [values]))
        self._count += 1
        if not self._count % _FLUSH:
            self._writer.flush()
        return []

    def _now(self) -> int:
        return EPOCH_NS + self.real.tick * PERIOD_NS + self.jump_ns

    def _write(self, name: str, message: Any, *, latched: bool = False) -> None:
        if name not in self._without:
            topic = Topic(f"/servo/{name}", type_of(type(message)), latched=latched)
            self._writer.write(topic, encoded(message), self._now())
