"""The target of libFuzzer: its corpus always, and the fuzzer itself for some seconds where there is one."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import freemaster_fuzz
import pytest
from firmware_compiler import CompileProgram, has_library
from freemaster_model import SERVO

RUNS = 4000
SANITIZED = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
INPUTS = sorted(freemaster_fuzz.CORPUS.iterdir())


def replay(program: Path, *inputs: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}
    return subprocess.run(
        [str(program), *map(str, inputs)], capture_output=True, text=True, check=False, timeout=120, env=environment
    )


def test_corpus(compile_program: CompileProgram, tmp_path: Path) -> None:
    if not has_library("gcc", "libasan.so") or not has_library("gcc", "libubsan.so"):
        pytest.skip("gcc has no sanitizers")
    defines = [*SERVO.defines, "FUZZ_REPLAY"]
    program = compile_program("freemaster_replay", freemaster_fuzz.sources(tmp_path), SANITIZED, defines)
    result = replay(program, *INPUTS)
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.splitlines() == [str(path) for path in INPUTS]


def test_inputs_made_by_hand_are_in_the_corpus() -> None:
    assert {path.name for path in INPUTS} >= freemaster_fuzz.seeds().keys()
    for name, data in freemaster_fuzz.seeds().items():
        assert (freemaster_fuzz.CORPUS / name).read_bytes() == data, "freemaster_fuzz.py --seeds writes them"


def test_fuzzer_finds_nothing(tmp_path: Path) -> None:
    try:
        target = freemaster_fuzz.build(tmp_path)
    except OSError:
        pytest.skip("clang is not installed")
    except subprocess.CalledProcessError as error:
        if "libclang_rt.fuzzer" in error.stderr:
            pytest.skip("clang has no libFuzzer (libclang-rt-dev)")
        raise
    found = tmp_path / "found"
    found.mkdir()
    command = [target, f"-runs={RUNS}", "-max_total_time=10", "-seed=1", f"-artifact_prefix={tmp_path}/"]
    result = subprocess.run(
        [*map(str, command), str(found), str(freemaster_fuzz.CORPUS)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr[-3000:]
