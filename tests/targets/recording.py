"""Run a scenario on the virtual board and record all calls of ``hal/hal.h``."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cffi
from servo_twin._build_native import declarations
from servo_twin.board import Firmware
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
"""Functions of ``servo.h`` that are not called by a port."""

_HEADER: Final = struct.Struct("<4sIII")
_ARITHMETIC: Final = struct.Struct("<4sII")
_CRC_FLIP: Final = 0xFFFFFFFF
"""zlib returns the complement of the CRC of the targets."""


@dataclass(frozen=True)
class Scenario:
    """Sequence of commands and disturbances for a board."""

    name: str  # short name; the docstring of `play` describes it
    plant: PlantConfig  # plant data
    play: Callable[[Rig], None]  # runs it on a board after power-on


@dataclass(frozen=True)
class Recording:
    """Recorded run with the outputs of the core."""

    name: str  # name of the scenario
    image: bytes  # input of a replay program
    digest: int  # check value of all outputs
    checks: tuple[int, ...]  # intermediate check values, one per `CHECK_PERIODS`
    periods: int  # length of the run [PWM periods]
    log: memoryview  # all calls, encoded by the recorder; see `calls`
    fields: dict[int, str]  # names of the entries in the table of variables, by index

    def calls(self, first: int = 0, last: int | None = None) -> list[Call]:
        """Calls of the periods `first` to `last`, inclusive."""
        end = self.periods if last is None else last
        return [call for call in parse_log(self.log) if first <= call.period <= end]

    def printing(self, first: int, last: int) -> bytes:
        """Return the image with the request to print each call of the periods `first` to `last`."""
        name, every, _, _ = _HEADER.unpack_from(self.image)
        return _HEADER.pack(name, every, first, last) + self.image[_HEADER.size :]


@dataclass(frozen=True)
class Arithmetic:
    """Results of functions of the core for random arguments (``arithmetic.h``)."""

    name: str  # for messages
    image: bytes  # input of a replay program
    digest: int  # check value of all results
    checks: tuple[int, ...]  # check value of each group
    groups: tuple[str, ...]  # names of the groups of functions


class Recorder:
    """The virtual board with the recorder between core and chip, compiled for the host.

    Parameters
    ----------
    sources : Sources
        C sources.
    folder : Path
        Folder of the library.
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
        self._firmware = Firmware(ffi, ffi.dlopen(str(library)), str(library))

    def record(self, scenario: Scenario, seed: int = 1, check_periods: int = CHECK_PERIODS) -> Recording:
        """Play a scenario.

        Raises
        ------
        TargetError
            If something cannot be recorded.
        targets.rig.RigError
            If the board does not reach a state that the scenario requires.
        """
        ffi, lib, _ = self._firmware
        lib.record_begin(check_periods)
        with closing(Rig(self._firmware, scenario.plant, seed)) as rig:
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
            )

    def arithmetic(self, seed: int = 1, rounds: int = ARITHMETIC_ROUNDS) -> Arithmetic:
        """Compute the arithmetic on the host."""
        ffi, lib, _ = self._firmware
        groups = range(lib.arithmetic_groups())
        checks = tuple(int(lib.arithmetic_digest(group, seed, rounds)) for group in groups)
        return Arithmetic(
            name="arithmetic",
            image=_ARITHMETIC.pack(ARITHMETIC_NAME, seed, rounds),
            digest=zlib.crc32(struct.pack(f"<{len(checks)}I", *checks)) ^ _CRC_FLIP,
            checks=checks,
            groups=tuple(ffi.string(lib.arithmetic_name(group)).decode() for group in groups),
        )


def wrapped_functions(sources: Sources) -> list[str]:
    """Functions that the recorder wraps: all of ``hal.h``, and the entry points.

    A new function without a counterpart in ``recorder.c`` fails to link.
    """
    names = _FUNCTION.findall((sources.firmware / "hal" / "hal.h").read_text(encoding="utf-8"))
    entries = _FUNCTION.findall((sources.firmware / "app" / "servo.h").read_text(encoding="utf-8"))
    return names + [name for name in entries if name not in _NOT_AN_ENTRY]
