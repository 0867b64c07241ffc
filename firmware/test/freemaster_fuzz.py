"""Fuzz the FreeMASTER server with libFuzzer: ``make fuzz``, and the corpus for the tests.

``freemaster_fuzz.c`` describes the inputs. Inputs that reach new paths stay in the folder of new inputs; the input of
a crash is saved as a file that ``--replay`` runs again. ``--seeds`` writes the inputs made by hand into the corpus.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_compiler import FIRMWARE, STRICT, TEST
from freemaster_model import COMM_SOURCES, ENTRIES, SERVO, sleb, uleb
from freemaster_recorder import START, STOP, memory, variable

CORPUS: Final = TEST / "corpus" / "freemaster"
FUZZ_FLAGS: Final = ("-g", "-O1", "-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all")
_INPUT_MAX: Final = 1024


def sources(folder: Path) -> list[str | Path]:
    """C files of the target; the table of variables is written into the folder."""
    table = folder / "table.c"
    table.write_text(SERVO.c_source(), encoding="ascii")
    return [*COMM_SOURCES, "test/freemaster_harness.c", "test/freemaster_fuzz.c", table]


def build(folder: Path, compiler: str = "clang") -> Path:
    """Compile the target of libFuzzer.

    Raises
    ------
    OSError
        If there is no such compiler.
    subprocess.CalledProcessError
        If it fails, for example because it has no libFuzzer.
    """
    target = folder / "freemaster_fuzz"
    command = [compiler, *STRICT, *FUZZ_FLAGS, f"-I{FIRMWARE}", f"-I{TEST}", *(f"-D{it}" for it in SERVO.defines)]
    command += [str(FIRMWARE / source) for source in sources(folder)]
    subprocess.run([*command, "-o", str(target)], check=True, capture_output=True, text=True)
    return target


# ---- corpus --------------------------------------------------------------------------------------------------------


def frame(code: int, payload: bytes = b"") -> bytes:
    """A step that sends a frame."""
    body = bytes([code]) + payload
    return bytes([1, len(body)]) + body


def seeds() -> dict[str, bytes]:
    """Inputs that visit every command, by name."""
    at = uleb(SERVO.variables + 0x20)
    slot = bytes([0]) + at + b"\x02"
    steps = {
        "configuration": b"".join(frame(0x20, uleb(i)) for i in range(13)) + frame(0x20, b"\0MTU\0"),
        "read": frame(0x21, at + b"\x02")
        + frame(0x22, sleb(0x20) + b"\x02")
        + frame(0x21, uleb(SERVO.table) + b"\x30"),
        "write": frame(0x23, b"\0" + at + b"\x02\x2b\x2b") + frame(0x23, b"\x01" + at + b"\x02\xff\xff\xf0\x0f"),
        "scope": frame(0x26, b"\0\x01\x01\x02\x02" + bytes([len(slot)]) + slot) + frame(0x27, b"\0"),
        "recorder": frame(0x24, b"\0" + memory(1, 8, 3) + variable(0, SERVO.variables + 0x20, 2, 0x11, b"\x05") + START)
        + b"\x04\x20"
        + bytes(32)
        + frame(0x25, b"\0\x83")
        + frame(0x21, uleb(SERVO.samples) + b"\x10")
        + frame(0x24, b"\0" + STOP)
        + frame(0x25, b"\0\x84"),
        "table": frame(0x29, b"\0") + frame(0x2A, uleb(SERVO.strings)),
        "command": frame(0x30, b"\x11\x01\x02") + frame(0x31) + frame(0x32, b"\x02\x00"),
        "later": frame(0x30, b"\xfe") + frame(0x31) + b"\x03\x03\x21ok" + frame(0x31) + frame(0x32, b"\x02\x00"),
        "pipe": b"\x02\x04text" + frame(0x28, b"\x01\0") + frame(0x28, b"\x81\x02abc") + frame(0x2F, b"\0\0\x81"),
        "login": frame(0x2C, b"\x03")
        + frame(0x2D, b"\x03" + bytes(20))
        + frame(0x21, at + b"\x02")
        + frame(0x2C, b"\0"),
        "refused": b"".join(
            frame(0x23, b"\0" + uleb(address) + b"\x02\0\0") + frame(0x21, uleb(address) + uleb(300))
            for address in (SERVO.variables + 0x2A, SERVO.variables + 0x22E, SERVO.strings, SERVO.table, 0, 2**32 - 1)
        )
        + frame(0x26, b"\0\x01\x01\x18")
        + b"".join(frame(0x26, b"\0\x02" + bytes([len(slot), k]) + slot[1:]) for k in (23, 24, 25, 64, 200))
        + frame(0x27, b"\0"),
        "line": b"\0\x05\x2b\x20\x01\x01\x51\0\x04\x2b\x2b\x2b\x21\0\x03\x2b\x21\xff" + frame(0x20, b"\x01"),
        "all": b"".join(
            frame(0x21, uleb(SERVO.address(entry)) + uleb(entry.size)) for entry in ENTRIES if not entry.absolute
        ),
    }
    return {name: bytes([7 if name == "login" else 0]) + data for name, data in steps.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit status of the fuzzer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=600, help="duration (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=FIRMWARE.parent / "out" / "fuzz", metavar="DIR", help="new inputs")
    parser.add_argument("--replay", type=Path, nargs="+", metavar="FILE", help="run these inputs only")
    parser.add_argument("--seeds", action="store_true", help="write the committed inputs that are made by hand")
    args = parser.parse_args(arguments)
    if args.seeds:
        CORPUS.mkdir(parents=True, exist_ok=True)
        for name, data in seeds().items():
            (CORPUS / name).write_bytes(data)
        return 0
    if shutil.which("clang") is None:
        print("fuzzing needs clang with libFuzzer: apt-get install clang libclang-rt-dev", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        try:
            target = build(Path(name))
        except subprocess.CalledProcessError as error:
            print(f"clang cannot build the target:\n{error.stderr}", file=sys.stderr)
            return 2
        if args.replay:
            return subprocess.run([str(target), *map(str, args.replay)], check=False).returncode
        found = args.out / "freemaster"
        found.mkdir(parents=True, exist_ok=True)
        options = [f"-max_total_time={args.seconds}", f"-max_len={_INPUT_MAX}", f"-artifact_prefix={found}/"]
        return subprocess.run([str(target), *options, "-print_final_stats=1", found, CORPUS], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
