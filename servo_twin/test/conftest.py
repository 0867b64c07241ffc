"""Fixtures of the virtual board: its C parts, each compiled separately."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import common_rig  # noqa: F401
import pytest

# The helper modules of this folder, and one of the firmware's, can be imported under every import mode of pytest.
TEST = Path(__file__).resolve().parent
FIRMWARE = TEST.parents[1] / "firmware"
sys.path[:0] = [folder for folder in (str(TEST), str(FIRMWARE / "test")) if folder not in sys.path]

import chip_rig  # noqa: E402
import stm32_rig  # noqa: E402
from native_library import NATIVE, PLANT, Native, compile_c  # noqa: E402
from servo_twin.level import LEVEL_VARIABLE  # noqa: E402


@pytest.fixture(params=[os.environ[LEVEL_VARIABLE]] if LEVEL_VARIABLE in os.environ else ["ideal", "registers"])
def level(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Default level of boards: both levels, or only the level of the environment variable."""
    monkeypatch.setenv(LEVEL_VARIABLE, request.param)
    return str(request.param)


@pytest.fixture(scope="session")
def plant_c(tmp_path_factory: pytest.TempPathFactory) -> Native:
    """Compiled plant (``ffi``, ``lib``)."""
    return compile_c(tmp_path_factory.mktemp("plant"), "plant_under_test", ["plant/plant.h"], PLANT)


@pytest.fixture(scope="session")
def chip_c(tmp_path_factory: pytest.TempPathFactory) -> Native:
    """Ideal chip with a fake firmware that records its calls (``ffi``, ``lib``)."""
    fake = TEST / "fake_firmware"
    sources = [*PLANT, *(NATIVE / name for name in ("ideal_chip.c", "uart.c", "flash.c")), fake / "servo.c"]
    folder = tmp_path_factory.mktemp("chip")
    return compile_c(folder, "chip_under_test", ["ideal_chip.h"], sources, (fake, NATIVE, FIRMWARE))


def build_switching(folder: Path, name: str, *defines: str) -> Native:
    straight_roots = (
        "unsigned straight_roots(const double f0[4], const double f1[4], const double d0[4], double h, double root[4])"
    )
    preamble = f"""
#include "plant/segment_trajectory.h"

static {straight_roots}
{{
    lanes_t roots;
    const unsigned good = chord_roots(load_lanes(f0), load_lanes(f1), load_lanes(d0), h, &roots);
    store_lanes(root, roots);
    return good;
}}
"""
    cdef = f"double root_of(double f0, double d0, double f1, double h); {straight_roots};"
    return compile_c(
        folder, name, ["plant/plant.h", "plant/switching.h"], PLANT, defines=defines, cdef=cdef, preamble=preamble
    )


@pytest.fixture(scope="session")
def switching_c(tmp_path_factory: pytest.TempPathFactory) -> Native:
    """Plant at switching level (``ffi``, ``lib``)."""
    return build_switching(tmp_path_factory.mktemp("switching"), "switching_under_test")


@pytest.fixture(scope="session")
def stepping_c(tmp_path_factory: pytest.TempPathFactory) -> Native:
    """Plant at switching level without linear intervals: all segments by the general integration."""
    return build_switching(tmp_path_factory.mktemp("stepping"), "stepping_under_test", "PLANT_GENERAL")


@pytest.fixture(scope="session")
def registers_c(tmp_path_factory: pytest.TempPathFactory) -> Native:
    """Chip at register level without a plant (``ffi``, ``lib``)."""
    return chip_rig.build(tmp_path_factory.mktemp("registers"))


@pytest.fixture
def rig(registers_c: Native) -> chip_rig.ChipRig:
    """A chip with running clocks, in an environment that the test defines."""
    return chip_rig.ChipRig(registers_c)


@pytest.fixture(scope="session")
def stm32_c(tmp_path_factory: pytest.TempPathFactory) -> Native:
    """The STM32F405 without its core (``ffi``, ``lib``)."""
    return stm32_rig.build(tmp_path_factory.mktemp("stm32"))


@pytest.fixture
def stm32(stm32_c: Native) -> stm32_rig.Stm32Rig:
    """A chip at 168 MHz with open clock gates."""
    return stm32_rig.Stm32Rig(stm32_c)
