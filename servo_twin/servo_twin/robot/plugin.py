"""Export of a virtual board as plugin of MuJoCo (``native/mujoco``), doc/coupling.md."""

from __future__ import annotations

import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from servo_msgs_py.output_file import write_file

from servo_twin._build_native import NATIVE
from servo_twin.exported_board import exported_board
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig
from servo_twin.simulation import SimulationError

_LIBRARY: Final = "servo_board"


def export_plugin(
    path: Path, plant: PlantConfig | None = None, seed: int = 1, servo: ServoConfig | None = None
) -> None:
    """Compile a board for the installed MuJoCo and write it as a plugin library.

    Parameters
    ----------
    path : Path
        File to be written.
    plant : PlantConfig, optional
        Values of the parameters that a model does not set; the packaged plant by default.
    seed : int
        Seed of all random numbers.
    servo : ServoConfig, optional
        Configuration of the firmware; that of ``firmware/config/servo.toml`` by default.

    Raises
    ------
    SimulationError
        If MuJoCo is not installed, there is no compiler, or it fails.
    OSError
        If the package is not in a checkout with the sources of the firmware, or the file cannot be written.
    """
    found = find_spec("mujoco")
    if found is None or found.origin is None:
        raise SimulationError("no package mujoco; install servo_twin[mujoco]")
    folder = Path(found.origin).parent
    library = next(folder.glob("libmujoco.so.*"), None)
    if library is None:
        raise SimulationError(f"no libmujoco.so in {folder}; install the wheel: servo_twin[mujoco]")
    options: list[str | Path] = ["-isystem", folder / "include", library]
    shell = sorted((NATIVE / "mujoco").glob("*.c"))
    with exported_board(_LIBRARY, shell, plant, servo, seed, options) as board, board.library.open("rb") as compiled:
        write_file(path, lambda stream: shutil.copyfileobj(compiled, stream))
