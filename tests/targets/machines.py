"""The targets: compilers with options, and the machines that run the programs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from targets.sources import SAMPLES, STRICT, Sources
from targets.toolchain import compile_objects, has_library, has_program, run

AVR_MCU: Final = "atmega2560"
AVR_OPTIONS: Final = (f"-mmcu={AVR_MCU}", "-fwrapv", "-mrelax")
"""A sum that exceeds 16 bits wraps, as on the 56800EX; else the compiler may widen it and hide a missing cast."""

AVR_RAM_END: Final = 0xEFFF
"""Last RAM address of the simulator."""

TIMEOUT: Final = 300.0
"""Time-out of a simulator for one recording [s]; the slowest one needs 7 s."""

_BARE: Final = ("-mthumb", "-ffreestanding", "-ffunction-sections", "-fdata-sections")

CORTEX_M3: Final = ("-mcpu=cortex-m3", *_BARE)
"""Options of every program for the Cortex-M3."""

CORTEX_M4: Final = ("-mcpu=cortex-m4", "-mfloat-abi=soft", *_BARE)
"""Options of every program for the Cortex-M4."""

_QEMU_OPTIONS: Final = (
    *("-display", "none", "-monitor", "none", "-serial", "stdio"),
    *("-semihosting-config", "enable=on,target=native"),
)
QEMU: Final = ("qemu-system-arm", "-M", "mps2-an385", *_QEMU_OPTIONS)
QEMU_M4: Final = ("qemu-system-arm", "-M", "mps2-an386", *_QEMU_OPTIONS)
QEMU_IMAGE_ADDRESS: Final = 0x21000000

ARITHMETIC_NAME: Final = b"SRVA"
"""First bytes of an image of the arithmetic; all other images are recordings (``trace.h``)."""


class Program(Protocol):
    """A built program."""

    def run(self, image: bytes) -> str:
        """Run the program with an image and return its output.

        Raises
        ------
        TargetError
            If the program fails.
        """


class Target(Protocol):
    """A compiler with options, and a machine."""

    @property
    def name(self) -> str: ...

    @property
    def about(self) -> str:
        """Purpose of this target."""

    @property
    def packages(self) -> tuple[str, ...]:
        """Required Debian packages."""

    @property
    def weight(self) -> float:
        """Run time relative to the host."""

    def available(self) -> bool: ...

    def build(self, sources: Sources, folder: Path) -> Program:
        """Build the replay program in an empty folder.

        Raises
        ------
        TargetError
            If it does not compile.
        """


# ---- the host -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HostProgram:
    """Executable of the host; the image is its standard input."""

    path: Path

    def run(self, image: bytes) -> str:
        return run([self.path], data=image)


@dataclass(frozen=True)
class Host:
    """A compiler for the machine that runs the tests."""

    name: str  # name of the target
    compiler: str  # command
    options: tuple[str, ...]  # compiler options
    about: str  # purpose of the target
    packages: tuple[str, ...]  # required Debian packages
    libraries: tuple[str, ...] = ()  # files of the compiler that the options need
    weight: float = 1.0  # run time relative to the host

    def available(self) -> bool:
        return has_program(self.compiler) and all(has_library(self.compiler, name) for name in self.libraries)

    def build(self, sources: Sources, folder: Path) -> HostProgram:
        program = folder / "replay"
        machine = sources.native / "host"
        include = [f"-I{path}" for path in (sources.firmware, sources.native, machine)]
        files = [*sources.core(), *sources.replay(), machine / "machine.c"]
        objects = compile_objects(
            [self.compiler, *STRICT, SAMPLES, *self.options, *include], files, folder, sources.root
        )
        run([self.compiler, *self.options, *objects, "-o", program])
        return HostProgram(program)


# ---- Cortex-M3 ------------------------------------------------------------------------------------------------------


def cortex_compiler(sources: Sources, options: Sequence[str]) -> list[str]:
    """Compiler and options; these contain `CORTEX_M3` or `CORTEX_M4`."""
    include = [f"-I{path}" for path in (sources.firmware, sources.native, sources.port("cortex_m3"))]
    return ["arm-none-eabi-gcc", *STRICT, *options, *include]


def build_cortex(sources: Sources, output: Path, files: Sequence[Path], options: Sequence[str]) -> Path:
    """Compile and link a program from sources or objects `files` and the start-up code; `options`: see above."""
    port, compiler = sources.port("cortex_m3"), cortex_compiler(sources, options)
    link = ["-nostdlib", "-T", str(port / "mps2.ld"), "-Wl,--gc-sections", "-o", str(output)]
    everything = [*files, port / "machine.c", port / "startup.c"]
    texts = [path for path in everything if path.suffix == ".c"]
    with tempfile.TemporaryDirectory() as folder:
        compiled = dict(zip(texts, compile_objects(compiler, texts, Path(folder), sources.root), strict=True))
        # In their order, which determines the addresses.
        run([*compiler, *link, *(compiled.get(path, path) for path in everything), "-lc", "-lgcc"])
    return output


@dataclass(frozen=True)
class QemuProgram:
    """Program for the Cortex-M3; the image is loaded into memory."""

    path: Path
    options: tuple[str, ...] = ()

    def run(self, image: bytes) -> str:
        with tempfile.NamedTemporaryFile(dir=self.path.parent, suffix=".image") as file:
            file.write(image)
            file.flush()
            loader = f"loader,file={file.name},addr={QEMU_IMAGE_ADDRESS:#x},force-raw=on"
            return run([*QEMU, *self.options, "-device", loader, "-kernel", self.path], timeout=TIMEOUT)


@dataclass(frozen=True)
class _Cortex:
    """A bare Cortex-M: its programs are for the mps2 boards."""

    optimisation: str
    core: str
    about: str
    packages: tuple[str, ...] = ("gcc-arm-none-eabi", "libnewlib-arm-none-eabi", "qemu-system-arm")
    weight: float = 4.0  # run time relative to the host

    @property
    def name(self) -> str:
        return f"{self.core} {self.optimisation}"

    def available(self) -> bool:
        return has_library("arm-none-eabi-gcc", "libc.a") and has_program(QEMU[0])


@dataclass(frozen=True)
class CortexM3(_Cortex):
    """A bare Cortex-M3 in QEMU."""

    core: str = "cortex-m3"
    about: str = "Cortex-M3, bare metal, QEMU mps2-an385"

    def build(self, sources: Sources, folder: Path) -> QemuProgram:
        return QemuProgram(_replay_elf(sources, folder, [*CORTEX_M3, self.optimisation, SAMPLES]))


def _replay_elf(sources: Sources, folder: Path, options: Sequence[str]) -> Path:
    """The replay program for the mps2 boards."""
    files = [*sources.core(), *sources.replay()]
    objects = compile_objects(cortex_compiler(sources, options), files, folder, sources.root)
    return build_cortex(sources, folder / "replay.elf", objects, options)


# ---- Cortex-M4, executed by the virtual board's own core -------------------------------------------------------------


@dataclass(frozen=True)
class ArmProgram:
    """Program for the Cortex-M4 with the core that executes it (servo_twin/native/arm)."""

    elf: Path
    simulator: Path

    def run(self, image: bytes) -> str:
        with tempfile.NamedTemporaryFile(dir=self.elf.parent, suffix=".image") as file:
            file.write(image)
            file.flush()
            return run([self.simulator, self.elf, file.name], timeout=TIMEOUT)


def build_arm_simulator(sources: Sources, folder: Path, options: Sequence[str] = ("-O2",)) -> Path:
    """Compile the core of the virtual board as a machine for programs of the mps2 boards."""
    program = folder / "arm_simulator"
    files = [*sorted((sources.twin / "arm").glob("*.c")), sources.native / "arm_simulator.c"]
    compiler = ["gcc", *STRICT, *options, f"-I{sources.twin}"]
    run([*compiler, *compile_objects(compiler, files, folder, sources.root), "-o", program])
    return program


@dataclass(frozen=True)
class CortexM4(_Cortex):
    """A bare Cortex-M4, executed by the core of the virtual board."""

    core: str = "cortex-m4"
    about: str = "Cortex-M4, bare metal, servo_twin/native/arm"

    def build(self, sources: Sources, folder: Path) -> ArmProgram:
        simulator = build_arm_simulator(sources, folder)
        return ArmProgram(_replay_elf(sources, folder, [*CORTEX_M4, self.optimisation, SAMPLES]), simulator)


# ---- AVR ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class AvrProgram:
    """Program for the AVR with its simulator (firmware/port/avr/simulator.c)."""

    elf: Path
    simulator: Path

    def run(self, image: bytes) -> str:
        with tempfile.NamedTemporaryFile(dir=self.elf.parent) as file:
            file.write(image)
            file.flush()
            text = run([self.simulator, self.elf, file.name], timeout=TIMEOUT)
        return "".join(
            line for line in text.splitlines(keepends=True) if not line.startswith("Loaded ")
        )  # message of simavr


@dataclass(frozen=True)
class Avr:
    """A machine whose `int` has 16 bits, as on the 56800EX."""

    optimisation: str = "-Os"
    about: str = "16-bit int, ATmega2560, simavr"
    packages: tuple[str, ...] = ("gcc-avr", "avr-libc", "libsimavr-dev")
    weight: float = 100.0  # run time relative to the host

    @property
    def name(self) -> str:
        return f"avr {self.optimisation}"

    def available(self) -> bool:
        return has_library("avr-gcc", "libc.a") and has_library("gcc", "libsimavr.so")

    def build(self, sources: Sources, folder: Path) -> AvrProgram:
        port = sources.port("avr")
        options = [*STRICT, SAMPLES, *AVR_OPTIONS, "-ffunction-sections", "-fdata-sections"]
        compiler = ["avr-gcc", *options, *(f"-I{path}" for path in (sources.firmware, sources.native, port))]
        objects = compile_objects([*compiler, self.optimisation], sources.core(), folder, sources.root)
        # Reading the recording and the digest take a quarter of the time. The core with -O2 hardly fits the flash.
        replay = [*sources.replay(), port / "machine.c"]
        objects += compile_objects([*compiler, "-O2"], replay, folder, sources.root)
        program = AvrProgram(folder / "replay.elf", folder / "simulator")
        memory = [f"-Wl,--defsym={name}={AVR_RAM_END:#x}" for name in ("__stack", "__DATA_REGION_LENGTH__")]
        run(["avr-gcc", f"-mmcu={AVR_MCU}", "-mrelax", "-Wl,--gc-sections", *memory, *objects, "-o", program.elf])
        host = ["gcc", "-std=gnu99", "-O2", f"-DMACHINE_RAM_END={AVR_RAM_END:#x}"]
        run([*host, port / "simulator.c", "-lsimavr", "-o", program.simulator])
        return program


def missing_text(target: Target) -> str:
    """Message with the command that installs the tools of a target."""
    return f"a tool is missing: sudo apt-get install {' '.join(target.packages)}"


_NO_RECOVERY: Final = ("-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-g")

TARGETS: Final[tuple[Target, ...]] = (
    Host("gcc -O0", "gcc", ("-O0",), "the code as written", ("gcc", "libc6-dev")),
    Host("gcc -O3", "gcc", ("-O3",), "all optimisations", ("gcc", "libc6-dev")),
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
    CortexM4("-Os"),
    CortexM4("-O2"),
    Avr(),
)
