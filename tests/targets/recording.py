"""Run a scenario on the virtual board and keep what crosses ``hal/hal.h``."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cffi
from servo_twin._build_native import declarations
from servo_twin.plant import PlantConfig

from targets.calls import Call, parse_log
from targets.machines import ARITHMETIC_NAME
from targets.rig import Rig
from targets.sources import SAMPLES, STRICT, Sources
from targets.toolchain import TargetError, compile_objects, run

CHECK_PERIODS: Final = 160
"""PWM periods between two check values: 10 ms."""

ARITHMETIC_ROUNDS: Final = 150

_FUNCTION: Final = re.compile(r"^\w+(?: \*)? (\w+)\(", re.MULTILINE)
_NOT_AN_ENTRY: Final = ("servo_read", "servo_write", "servo_restore", "servo_host_init")
"""Functions of ``servo.h`` that no port calls."""

_HEADER: Final = struct.Struct("<4sIII")
_ARITHMETIC: Final = struct.Struct("<4sII")
_CRC_FLIP: Final = 0xFFFFFFFF
"""zlib returns the complement of what the targets fold."""


@dataclass(frozen=True)
class Scenario:
    """Something that a board is made to go through.

    Attributes
    ----------
    name : str
        For people; more about it says the documentation of `play`.
    plant : PlantConfig
        What is really there.
    play : callable
        Does it to a board that has just been switched on.
    """

    name: str
    plant: PlantConfig
    play: Callable[[Rig], None]


@dataclass(frozen=True)
class Recording:
    """A recorded run, and what the core did in it.

    Attributes
    ----------
    image : bytes
        What a replay program is fed with.
    digest, checks : int, tuple of int
        Check values of all that the core did.
    periods : int
        PWM periods.
    log : memoryview
        Every call in the recorder's own words; see `calls`.
    fields : dict
        Names of the entries in the table of variables.
    written : tuple of (str, tuple of int)
        Variables that the host wrote, and the raw numbers.
    """

    name: str
    image: bytes
    digest: int
    checks: tuple[int, ...]
    periods: int
    log: memoryview
    fields: dict[int, str]
    written: tuple[tuple[str, tuple[int, ...]], ...]

    def calls(self, first: int = 0, last: int | None = None) -> list[Call]:
        """Calls of the periods `first` to `last`, which is included."""
        end = self.periods if last is None else last
        return [call for call in parse_log(self.log) if first <= call.period <= end]

    def printing(self, first: int, last: int) -> bytes:
        """Return the image with the wish to have each call of some periods printed."""
        name, every, _, _ = _HEADER.unpack_from(self.image)
        return _HEADER.pack(name, every, first, last) + self.image[_HEADER.size :]


@dataclass(frozen=True)
class Arithmetic:
    """Functions of the core on numbers that no run brings about (``arithmetic.h``), and what comes out.

    Attributes
    ----------
    image : bytes
        What a replay program is fed with.
    digest, checks : int, tuple of int
        Check value of everything, and of each group.
    groups : tuple of str
        Names of the groups of functions.
    """

    name: str
    image: bytes
    digest: int
    checks: tuple[int, ...]
    groups: tuple[str, ...]


class Recorder:
    """The virtual board with the recorder between core and chip, compiled for the host.

    Parameters
    ----------
    sources : Sources
        What is compiled.
    folder : Path
        Where the library is put.
    """

    def __init__(self, sources: Sources, folder: Path) -> None:
        library = folder / "librecorder.so"
        headers = [
            sources.twin / "chip" / "trace.h",
            sources.twin / "board.h",
            sources.native / "recorder.h",
            sources.native / "arithmetic.h",
        ]
        ffi = cffi.FFI()
        for header in headers:
            ffi.cdef(declarations(header.read_text(encoding="utf-8")))
        include = [f"-I{path}" for path in (sources.firmware, sources.twin, sources.native)]
        wrap = [f"-Wl,--wrap={name}" for name in wrapped_functions(sources)]
        # Without contraction of a * b + c the plant computes the same bits on every processor.
        command = ["gcc", *STRICT, SAMPLES, "-O2", "-ffp-contract=off", "-fPIC", *include]
        objects = compile_objects(command, sources.recorder(), folder, sources.root)
        run(["gcc", "-shared", "-Wl,-z,defs", *wrap, *objects, "-lm", "-o", library])
        self._ffi: Any = ffi
        self._lib: Any = ffi.dlopen(str(library))

    def record(self, scenario: Scenario, seed: int = 1, check_periods: int = CHECK_PERIODS) -> Recording:
        """Play a scenario.

        Raises
        ------
        TargetError
            If something cannot be recorded.
        targets.rig.RigError
            If the board does not do what the scenario waits for.
        """
        ffi, lib = self._ffi, self._lib
        lib.record_begin(check_periods)
        with Rig(ffi, lib, scenario.plant, seed) as rig:
            scenario.play(rig)
            if not lib.record_end():
                raise TargetError(f"{scenario.name}: {ffi.string(lib.record_problem()).decode()}")
            checks = lib.record_check_values()
            log = bytes(ffi.buffer(lib.record_log(), lib.record_log_size()))
            return Recording(
                name=scenario.name,
                image=bytes(ffi.buffer(lib.record_bytes(), lib.record_size())),
                digest=int(lib.record_digest()),
                checks=tuple(int(checks[i]) for i in range(lib.record_checks())),
                periods=int(lib.record_periods()),
                log=memoryview(log).cast("H"),
                fields=dict(enumerate(rig.entries)),
                written=tuple(rig.written),
            )

    def arithmetic(self, seed: int = 1, rounds: int = ARITHMETIC_ROUNDS) -> Arithmetic:
        """Let the host do the arithmetic."""
        groups = range(self._lib.arithmetic_groups())
        checks = tuple(int(self._lib.arithmetic_digest(group, seed, rounds)) for group in groups)
        return Arithmetic(
            name="arithmetic",
            image=_ARITHMETIC.pack(ARITHMETIC_NAME, seed, rounds),
            digest=zlib.crc32(struct.pack(f"<{len(checks)}I", *checks)) ^ _CRC_FLIP,
            checks=checks,
            groups=tuple(self._ffi.string(self._lib.arithmetic_name(group)).decode() for group in groups),
        )


def wrapped_functions(sources: Sources) -> list[str]:
    """Functions that the recorder has to stand between: all of ``hal.h``, and the entry points.

    A new one without a counterpart in ``recorder.c`` fails to link.
    """
    names = _FUNCTION.findall((sources.firmware / "hal" / "hal.h").read_text(encoding="utf-8"))
    entries = _FUNCTION.findall((sources.firmware / "app" / "servo.h").read_text(encoding="utf-8"))
    return names + [name for name in entries if name not in _NOT_AN_ENTRY]
