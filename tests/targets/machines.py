"""The targets: compilers with their options, and the machines that run what they make."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from targets.sources import SAMPLES, STRICT, Sources
from targets.toolchain import TargetError, TooLargeError, compile_objects, has_library, has_program, run

AVR_MCU: Final = "atmega1284p"
AVR_CLOCK: Final = 16_000_000
AVR_OPTIONS: Final = (f"-mmcu={AVR_MCU}", "-fwrapv", "-mrelax", "-mcall-prologues", "-mstrict-X", "-fno-inline")
"""A sum that is too large for 16 bits wraps, as on the 56800EX, where the compiler would be free to widen it and hide a
missing cast. The others make small programs: the flash has to hold a recording as well."""

AVR_DATA_MOST: Final = 15 * 1024
"""Bytes of static data, of 16 kB: the linker does not see that the stack needs the rest."""

PATIENCE: Final = 300.0
"""How long a simulator may take for one recording [s]; the slowest needs a dozen seconds."""

CORTEX_M3: Final = ("-mcpu=cortex-m3", "-mthumb", "-ffreestanding", "-ffunction-sections", "-fdata-sections")
"""Options of every program for the Cortex-M3."""

QEMU: Final = (
    *("qemu-system-arm", "-M", "mps2-an385", "-display", "none", "-monitor", "none", "-serial", "stdio"),
    *("-semihosting-config", "enable=on,target=native"),
)
QEMU_IMAGE_ADDRESS: Final = 0x21000000

ARITHMETIC_NAME: Final = b"SRVA"
"""Beginning of an image that asks for the arithmetic; all others are recordings (``trace.h``)."""

_EXCESS: Final = re.compile(r"overflowed by (\d+) bytes")
_COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")


class Program(Protocol):
    """A built program."""

    @property
    def remembers(self) -> bool:
        """Whether it has memory for what the core writes to its data flash."""

    def run(self, image: bytes) -> str:
        """Start the program with an image; returns what it printed.

        Raises
        ------
        TooLargeError
            If the machine has no room for the image.
        TargetError
            If the program fails.
        """


class Target(Protocol):
    """A compiler with options, and a machine."""

    @property
    def name(self) -> str: ...

    @property
    def about(self) -> str:
        """What this target is there for."""

    @property
    def packages(self) -> tuple[str, ...]:
        """Debian packages that it needs."""

    @property
    def weight(self) -> float:
        """How long it takes, compared with the host."""

    def available(self) -> bool: ...

    def build(self, sources: Sources, folder: Path) -> Program:
        """Build the replay program in an empty folder.

        Raises
        ------
        TargetError
            If the compiler refuses.
        """


# ---- the host -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HostProgram:
    """An executable of the host; the image goes in through its standard input."""

    path: Path
    remembers: bool = True

    def run(self, image: bytes) -> str:
        return run([self.path], data=image)


@dataclass(frozen=True)
class Host:
    """A compiler for the machine that runs the tests.

    Attributes
    ----------
    libraries : tuple of str
        Files of the compiler without which the options do not work.
    """

    name: str
    compiler: str
    options: tuple[str, ...]
    about: str
    packages: tuple[str, ...]
    libraries: tuple[str, ...] = ()
    weight: float = 1.0

    def available(self) -> bool:
        return has_program(self.compiler) and all(has_library(self.compiler, name) for name in self.libraries)

    def build(self, sources: Sources, folder: Path) -> HostProgram:
        program = folder / "replay"
        machine = sources.native / "host"
        include = [f"-I{path}" for path in (sources.firmware, sources.native, machine)]
        files = [*sources.core(), *sources.replay(), machine / "machine.c"]
        objects = compile_objects([self.compiler, *STRICT, SAMPLES, *self.options, *include], files, folder)
        run([self.compiler, *self.options, *objects, "-o", program])
        return HostProgram(program)


# ---- Cortex-M3 ------------------------------------------------------------------------------------------------------


def cortex_m3_compiler(sources: Sources, options: Sequence[str]) -> list[str]:
    """Compiler and options."""
    include = [f"-I{path}" for path in (sources.firmware, sources.native, sources.port("cortex_m3"))]
    return ["arm-none-eabi-gcc", *STRICT, *CORTEX_M3, *options, *include]


def build_cortex_m3(sources: Sources, output: Path, files: Sequence[Path], options: Sequence[str]) -> Path:
    """Compile and link a program for the Cortex-M3: `files`, which may be objects, and the machine."""
    port = sources.port("cortex_m3")
    link = ["-nostdlib", "-T", str(port / "mps2.ld"), "-Wl,--gc-sections", "-o", str(output)]
    everything = [*files, port / "machine.c", port / "startup.c"]
    run([*cortex_m3_compiler(sources, options), *link, *everything, "-lc", "-lgcc"])
    return output


@dataclass(frozen=True)
class QemuProgram:
    """A program for the Cortex-M3; the image lies in memory."""

    path: Path
    options: tuple[str, ...] = ()
    remembers: bool = True

    def run(self, image: bytes) -> str:
        with tempfile.NamedTemporaryFile(dir=self.path.parent, suffix=".image") as file:
            file.write(image)
            file.flush()
            loader = f"loader,file={file.name},addr={QEMU_IMAGE_ADDRESS:#x},force-raw=on"
            return run([*QEMU, *self.options, "-device", loader, "-kernel", self.path], timeout=PATIENCE)


@dataclass(frozen=True)
class CortexM3:
    """A bare Cortex-M3 in QEMU."""

    optimisation: str
    about: str = "Cortex-M3, bare metal, QEMU mps2-an385"
    packages: tuple[str, ...] = ("gcc-arm-none-eabi", "libnewlib-arm-none-eabi", "qemu-system-arm")
    weight: float = 4.0

    @property
    def name(self) -> str:
        return f"cortex-m3 {self.optimisation}"

    def available(self) -> bool:
        return has_library("arm-none-eabi-gcc", "libc.a") and has_program(QEMU[0])

    def build(self, sources: Sources, folder: Path) -> QemuProgram:
        options = [self.optimisation, SAMPLES]
        files = [*sources.core(), *sources.replay()]
        objects = compile_objects(cortex_m3_compiler(sources, options), files, folder)
        return QemuProgram(build_cortex_m3(sources, folder / "replay.elf", objects, options))


# ---- AVR ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class AvrProgram:
    """Programs for the AVR, as one object each; one is linked with each image, which lies behind it in flash.

    Attributes
    ----------
    replay, arithmetic : Path
        For recordings, and for images that ask for the arithmetic.
    image_source : Path
        Places an image.
    """

    replay: Path
    arithmetic: Path
    image_source: Path
    remembers: bool = False

    def run(self, image: bytes) -> str:
        with tempfile.TemporaryDirectory(dir=self.replay.parent) as name:
            folder = Path(name)
            (folder / "image.bin").write_bytes(image)
            define = f'-DMACHINE_IMAGE="{folder / "image.bin"}"'
            run(["avr-gcc", *AVR_OPTIONS, define, "-c", self.image_source, "-o", folder / "image.o"])
            elf = folder / "replay.elf"
            program = self.arithmetic if image.startswith(ARITHMETIC_NAME) else self.replay
            link = ["-Wl,--gc-sections", "-Wl,--undefined=machine_image_begin"]
            try:
                run(["avr-gcc", f"-mmcu={AVR_MCU}", "-mrelax", *link, program, folder / "image.o", "-o", elf])
            except TargetError as error:
                excess = _EXCESS.search(str(error))
                raise TooLargeError(str(error), int(excess[1])) if excess is not None else error from None
            _check_data(elf)
            text = run(["simavr", "-m", AVR_MCU, "-f", str(AVR_CLOCK), elf], merged=True, timeout=PATIENCE)
        # The simulator colours what the target prints and puts a dot for each line feed.
        lines = (line.removesuffix(".") for line in _COLOUR.sub("", text).splitlines())
        return "\n".join(line for line in lines if not line.startswith("Loaded ")) + "\n"


def _check_data(elf: Path) -> None:
    sizes = run(["avr-size", elf]).splitlines()[1].split()
    used = int(sizes[1]) + int(sizes[2])
    if used > AVR_DATA_MOST:
        raise TargetError(f"{used} bytes of static data leave too little for the stack of an {AVR_MCU}")


@dataclass(frozen=True)
class Avr:
    """A machine whose `int` has 16 bits, as on the 56800EX."""

    optimisation: str = "-Os"
    about: str = "16-bit int, ATmega1284P, simavr"
    packages: tuple[str, ...] = ("gcc-avr", "avr-libc", "simavr")
    weight: float = 200.0

    @property
    def name(self) -> str:
        return f"avr {self.optimisation}"

    def available(self) -> bool:
        return has_library("avr-gcc", "libc.a") and has_program("simavr")

    def build(self, sources: Sources, folder: Path) -> AvrProgram:
        port = sources.port("avr")
        options = [
            *AVR_OPTIONS,
            self.optimisation,
            "-flto",
            "-fno-toplevel-reorder",
            "-ffunction-sections",
            "-fdata-sections",
        ]
        include = [f"-I{path}" for path in (sources.firmware, sources.native, port)]

        files = [*sources.core(), *sources.replay(), port / "machine.c"]
        objects = compile_objects(["avr-gcc", *STRICT, SAMPLES, *options, *include], files, folder)
        replay, arithmetic = folder / "replay.o", folder / "arithmetic.o"
        for program, unwanted in ((replay, "native_arithmetic"), (arithmetic, "native_replay")):
            # Optimised as a whole, which needs a tenth less flash, and once for all images. The linker relaxes calls at
            # the end only: the assembler has to leave it the distances that this changes. gcc 5.4 makes wrong code
            # where it may reorder functions and data.
            needed = [path for path in objects if path.stem != unwanted]
            whole = [option for option in options if option != "-mrelax"]
            run(["avr-gcc", *whole, "-Wa,-mlink-relax", "-r", "-nostdlib", *needed, "-o", program])
        return AvrProgram(replay, arithmetic, port / "image.S")


def missing_text(target: Target) -> str:
    """What to do about a target that is not available."""
    return f"a tool is missing: sudo apt-get install {' '.join(target.packages)}"


_NO_RECOVERY: Final = ("-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-g")

TARGETS: Final[tuple[Target, ...]] = (
    Host("gcc -O0", "gcc", ("-O0",), "the code as written", ("gcc", "libc6-dev")),
    Host("gcc -O3", "gcc", ("-O3",), "everything a compiler may assume", ("gcc", "libc6-dev")),
    Host("clang -O2", "clang", ("-O2",), "another compiler", ("clang",)),
    Host(
        "gcc sanitizers",
        "gcc",
        ("-O1", "-fsanitize=undefined,address", *_NO_RECOVERY),
        "undefined behaviour and wrong addresses",
        ("gcc", "libc6-dev"),
        ("libasan.so", "libubsan.so"),
        3.0,
    ),
    CortexM3("-Os"),
    CortexM3("-O2"),
    CortexM3("-O3"),
    Avr(),
)
