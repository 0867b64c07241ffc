"""The complete state of a virtual board, for `Board.restore`, in this or in another process."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, get_args

from servo_msgs_py.catalogue import AXIS_NAMES
from servo_msgs_py.output_file import write_file

from servo_twin.board_memory import BoardError
from servo_twin.fault_injection import ChangedValue, InjectedFault, NativeFault
from servo_twin.level import Level
from servo_twin.plant import PlantConfig

_IMAGE: Final = "image"
_HEAD: Final = "state.json"
_SIZE_MAX: Final = 1 << 26  # of a file [bytes]
_FAULTS: Final = {kind.__name__: kind for kind in (*get_args(NativeFault), *get_args(ChangedValue))}


@dataclass(frozen=True)
class BoardState:
    """State of a board at an instant; can be pickled.

    The image belongs to the compiled library that wrote it; another build refuses it.
    """

    level: Level  # level of the board
    time_ns: int  # simulated time of the instant [ns]
    seed: int  # seed of the board
    plant: PlantConfig  # plant without the injected faults
    faults: tuple[InjectedFault, ...]  # injected faults, in their order
    image: bytes  # `board_save` of the native board

    def save(self, path: Path | str) -> None:
        """Write the state to a file (ZIP).

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        faults = [{"kind": type(fault).__name__, **vars(fault)} for fault in self.faults]
        plant = dataclasses.asdict(self.plant)
        plant |= zip(AXIS_NAMES, plant.pop("axes"), strict=True)
        head = {"level": self.level, "time_ns": self.time_ns, "seed": self.seed, "plant": plant, "faults": faults}

        def write(stream: IO[bytes]) -> None:
            with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
                file.writestr(_HEAD, json.dumps(head))
                file.writestr(_IMAGE, self.image)

        write_file(Path(path), write)

    @classmethod
    def load(cls, path: Path | str) -> BoardState:
        """Read a file of `save`.

        Raises
        ------
        BoardError
            If the file is not a complete state.
        OSError
            If the file cannot be read.
        """
        with Path(path).open("rb") as stream:
            content = io.BytesIO(stream.read(_SIZE_MAX))  # what is cut off is not a complete state
        try:
            with zipfile.ZipFile(content) as file:
                head: dict[str, Any] = json.loads(file.read(_HEAD))
                image = file.read(_IMAGE)
            faults = tuple(_FAULTS[fault.pop("kind")](**fault) for fault in head["faults"])
            plant = PlantConfig.parse(head["plant"])
            return cls(head["level"], head["time_ns"], head["seed"], plant, faults, image)
        except Exception as error:  # the bytes are in memory: whatever fails now, and in any library, is their damage
            raise BoardError(f"{path}: not a complete state of a board ({error})") from error
