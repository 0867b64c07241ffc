"""Build C parts of the virtual board as cffi modules for the tests."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from c_declarations import declarations
from cffi import FFI
from servo_twin.plant import AxisPlant, BusPlant, PlantConfig

NATIVE = Path(__file__).resolve().parents[1] / "native"

HALF_NS = 31_250
"""Half a PWM period [ns]."""


class Native(NamedTuple):
    """A compiled library with its cffi interface."""

    ffi: FFI
    lib: Any


def compile_c(
    folder: Path,
    name: str,
    headers: Sequence[str],
    sources: Sequence[Path],
    include: tuple[Path, ...] = (NATIVE,),
    defines: Sequence[str] = (),
    cdef: str = "",
    preamble: str = "",
) -> Native:
    """Compile C files to a module in `folder`, with the declarations of the headers and of `cdef` (see `preamble`)."""
    declared = re.sub(
        r"[^;{}]*\bboard_\w+\([^;{}]*\);", "", declarations(*headers, include=include)
    )  # no board is linked
    builder = FFI()
    builder.cdef(declared + cdef)
    builder.set_source(
        name,
        "".join(f'#include "{header}"\n' for header in headers) + preamble,
        sources=[str(path) for path in sources],
        include_dirs=[str(path) for path in include],
        libraries=["m"],
        define_macros=[(macro, None) for macro in defines],
        extra_compile_args=["-std=c99", "-O1", "-ffp-contract=off", "-Wno-psabi", "-MD"],
    )
    spec = importlib.util.spec_from_file_location(name, builder.compile(tmpdir=str(folder)))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return Native(module.ffi, module.lib)


PLANT = sorted((NATIVE / "plant").glob("*.c"))


def c_axis(native: Native, axis: AxisPlant) -> Any:
    """``plant_axis_t *`` of one axis."""
    start = 0.35 if axis.theta_start == "random" else axis.theta_start
    return native.ffi.new("plant_axis_t *", {**axis.members(), "theta_start": start})


def c_bus(native: Native, bus: BusPlant) -> Any:
    """``plant_bus_t *`` of a bus."""
    return native.ffi.new("plant_bus_t *", dict(vars(bus)))


def c_config(native: Native, plant: PlantConfig, seed: int = 0, baud: float = 115200.0) -> Any:
    """``board_config_t *`` of a plant."""
    config = native.ffi.new("board_config_t *")
    plant.drawn(seed).fill(config)
    config.baud, config.seed = baud, seed
    return config


def ideal_plant(plant: PlantConfig | None = None, **axis: Any) -> PlantConfig:
    """Plant with an ideal inverter, ideal sensors and no friction, with changes by the test."""
    plant = plant or PlantConfig.load()
    ideal = {
        "dead_time": 0.0, "v_drop": 0.0, "r_on": 0.0, "friction": 0.0, "viscous": 0.0, "i_noise": 0.0,
        "i_offset": (0.0, 0.0, 0.0), "i_break": 1e9, "theta_start": 0.0,
    }  # fmt: skip
    for index in range(2):
        plant = plant.with_axis(index, **{**ideal, **axis})
    return plant.with_bus(u_noise=0.0)
