"""Bytes of the application with and without the server, from the map of the linker."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from targets.machines import CORTEX_M3
from targets.sources import ROOMS, STRICT
from targets.toolchain import TargetError, compile_objects, run

from firmware_cost.programs import COMPILER, Programs

LIBRARY: Final = "library"
"""Library code of the compiler."""
VARIABLES: Final = "variables"
"""Table of variables of the server."""
SERVER: Final = "comm"

_ROOMS: Final = (*(room for room in ROOMS if room != SERVER), LIBRARY)
_TABLE_FILE: Final = "app_variables_gen.o"
_MAP: Final = "Linker script and memory map"
_PLACED: Final = re.compile(r"^ \.(text|rodata|data|bss)(\S*)\s+0x[0-9a-f]+\s+0x([0-9a-f]+)\s+(\S+)$", re.MULTILINE)
_STATE: Final = re.compile(r"^\S+ ([0-9a-f]+) \S state_of_server$", re.MULTILINE)


@dataclass(frozen=True)
class Size:
    """Bytes of instructions, constants, initialised and zeroed memory."""

    text: int = 0
    rodata: int = 0
    data: int = 0
    bss: int = 0

    def __add__(self, other: Size) -> Size:
        return Size(self.text + other.text, self.rodata + other.rodata, self.data + other.data, self.bss + other.bss)


@dataclass(frozen=True)
class Sizes:
    """Size of the application for both axes with one optimisation, without the board below ``hal/hal.h``."""

    complete: Size  # with the FreeMASTER server, its table of variables and its memory
    control: Size  # without them
    rooms: Mapping[str, Size]  # complete application by folder of the firmware, and `VARIABLES` and `LIBRARY`


def sizes(programs: Programs) -> Sizes:
    """Link the application with and without the server, and read the maps of the linker."""
    server, no_server = programs.objects([SERVER]), [_compiled(programs, "no_freemaster")]
    rooms = _placed(programs, "application", server)
    alone = _placed(programs, "alone", no_server)
    state = _servo_state(programs, "application")
    control = _sum(alone.get(room, Size()) for room in _ROOMS)
    return Sizes(
        complete=_sum(rooms.values()) + Size(bss=state),
        control=control + Size(bss=state - _server_state(programs)),
        rooms=rooms,
    )


def _sum(parts: Iterable[Size]) -> Size:
    total = Size()
    for part in parts:
        total += part
    return total


def _compiled(programs: Programs, name: str) -> Path:
    """Compile a C file of the bench."""
    sources = programs.sources
    include = [f"-I{path}" for path in (sources.firmware, sources.port("cortex_m3"), programs.bench)]
    options = [*STRICT, *CORTEX_M3, programs.optimisation, *include]
    (compiled,) = compile_objects([COMPILER, *options], [programs.bench / f"{name}.c"], programs.folder, sources.root)
    return compiled


def _placed(programs: Programs, name: str, server: list[Path]) -> dict[str, Size]:
    """Link the application; return bytes by folder."""
    rooms = [room for room in ROOMS if room != SERVER]
    bench = [_compiled(programs, "application"), _compiled(programs, "bench_board")]
    programs.link(name, [*programs.objects(rooms), *server, *bench], [f"-Wl,-Map={_map(programs, name)}"])
    result: dict[str, Size] = {}
    for kind, _, size, file in _sections(programs, name):
        group = _group(programs, Path(file))
        if group is not None:
            result[group] = result.get(group, Size()) + Size(**{kind: int(size, 16)})
    if missing := set(rooms) - set(result):
        raise TargetError(f"nothing of {', '.join(sorted(missing))} in the map of the linker")
    return result


def _map(programs: Programs, name: str) -> Path:
    return programs.folder / f"{name}.map"


def _sections(programs: Programs, name: str) -> list[tuple[str, str, str, str]]:
    """Placed sections: kind, rest of the name, hexadecimal size, file."""
    text = _map(programs, name).read_text(encoding="utf-8").partition(_MAP)[2]
    found = _PLACED.findall(re.sub(r"^( \.\S+)\n", r"\1", text, flags=re.MULTILINE))
    return [(kind, rest, size, file) for kind, rest, size, file in found]


def _group(programs: Programs, file: Path) -> str | None:
    """Part of the application of an object; None for the board and the start-up code."""
    if ".a(" in file.name:
        return LIBRARY
    if file.name == _TABLE_FILE:
        return VARIABLES
    return file.parent.name if file.parent.parent == programs.folder else None


def _servo_state(programs: Programs, name: str) -> int:
    """Memory of one servo_t, from application.c."""
    for kind, rest, size, _ in _sections(programs, name):
        if (kind, rest) == ("bss", ".servo"):
            return int(size, 16)
    raise TargetError("the application has no servo")


def _server_state(programs: Programs) -> int:
    """Memory of the server, which is a part of servo_t."""
    found = _STATE.search(run(["arm-none-eabi-nm", "-S", _compiled(programs, "server_state")]))
    if found is None:
        raise TargetError("server_state.c defines no state_of_server")
    return int(found[1], 16)
