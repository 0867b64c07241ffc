"""All costs of one state of the firmware."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from servo_twin._core_time import load_weights
from targets.sources import Sources
from targets.toolchain import run

from firmware_cost.calibration import Charges, Charging, charges, fit, kept, weights_text
from firmware_cost.instructions import Count, Counts, Setup, cost_program, count, name_of
from firmware_cost.programs import OBJCOPY, OPTIMISATIONS, Programs, compiler
from firmware_cost.recorder import recorder_costs, recorder_program
from firmware_cost.sizes import Size, Sizes, sizes
from firmware_cost.stages import Stages, stages

REFERENCE = "-O2"
"""Optimisation to which the aims apply."""


@dataclass(frozen=True)
class Measurement:
    """Costs per optimisation, and in more detail for `REFERENCE`."""

    compiler: str  # name and version
    fingerprint: str  # of the programs and the weights, see `fingerprint`
    counts: Mapping[str, Counts]  # instructions, by optimisation
    sizes: Mapping[str, Sizes]  # bytes, by optimisation
    all_features: Counts  # instructions with all features that the reference design does not have
    sensorless: Counts  # instructions of one phase without encoders
    stages: Stages  # instructions per source file
    recorder: Mapping[str, Count]  # instructions of a call of a recorder, by case
    charging: Charging  # program with the charges of the virtual core
    charge: Charges  # its counts without weights
    weights: Mapping[str, float]  # weight of each file in the price list of the virtual core, see `calibration`
    charged: Mapping[Setup, Counts]  # charges of the virtual core with these weights [1/16 instruction], by setup

    @property
    def by_setup(self) -> dict[Setup, Counts]:
        """Instructions of `REFERENCE`."""
        return {
            Setup.CONFIGURED: self.counts[REFERENCE],
            Setup.ALL_FEATURES: self.all_features,
            Setup.WITHOUT_ENCODERS: self.sensorless,
        }


def fingerprint(programs: Programs, weights: str) -> str:
    """First half of the SHA-256 of what was measured, and how: equal programs have equal counts.

    Parameters
    ----------
    programs : Programs
        Of `REFERENCE`; those of other optimisations have the same sources.
    weights : str
        Text of the file with the weights.
    """
    found = hashlib.sha256(weights.encode())
    for path in (*sorted(Path(__file__).parent.glob("*.py")), *sorted(programs.bench.rglob("*.[ch]"))):
        found.update(path.read_bytes())
    for path in (*(cost_program(programs, loops=loops) for loops in (False, True)), recorder_program(programs)):
        image = path.with_suffix(".bin")
        run([OBJCOPY, "-O", "binary", path, image])
        found.update(image.read_bytes())
    return found.hexdigest()[:32]


def measure(sources: Sources, folder: Path) -> Measurement:
    """Build, run and count.

    Parameters
    ----------
    sources : Sources
        Sources that do not change meanwhile: pass a copy.
    folder : Path
        Empty folder for objects and programs.

    Raises
    ------
    TargetError
        If a tool fails, or an axis does not spin.
    """
    programs = {level: Programs.compile(sources, folder / level.strip("-"), level) for level in OPTIMISATIONS}
    counts = {level: count(one) for level, one in programs.items()}
    others: dict[Setup, Counts] = {
        setup: count(programs[REFERENCE], setup) for setup in Setup if setup != Setup.CONFIGURED
    }
    by_setup: dict[Setup, Counts] = {Setup.CONFIGURED: counts[REFERENCE], **others}
    charging = Charging.build(sources, folder / "charges")
    charge = charges(charging)
    weights = kept(load_weights(), fit(charge, by_setup), charge)
    return Measurement(
        compiler(),
        fingerprint(programs[REFERENCE], weights_text(weights)),
        counts,
        {level: sizes(one) for level, one in programs.items()},
        others[Setup.ALL_FEATURES],
        others[Setup.WITHOUT_ENCODERS],
        stages(programs[REFERENCE]),
        recorder_costs(programs[REFERENCE]),
        charging,
        charge,
        weights,
        charging.charged(weights),
    )


def plain(measurement: Measurement) -> dict[str, Any]:
    """The measurement as dictionaries and numbers."""
    return {
        "compiler": measurement.compiler,
        "fingerprint": measurement.fingerprint,
        "instructions": {level: _counts(counts) for level, counts in measurement.counts.items()},
        "instructions_all_features": {REFERENCE: _counts(measurement.all_features)},
        "instructions_sensorless": {REFERENCE: _counts(measurement.sensorless)},
        "stages": {REFERENCE: {"fast": dict(measurement.stages.fast), "slow": dict(measurement.stages.slow)}},
        "recorder": {REFERENCE: {case: one.mean for case, one in measurement.recorder.items()}},
        "bytes": {level: _sizes(one) for level, one in measurement.sizes.items()},
    }


def _counts(counts: Counts) -> dict[str, dict[str, dict[str, float]]]:
    result: dict[str, dict[str, dict[str, float]]] = {}
    for (phase, kind), one in counts.items():
        numbers = {"number": one.number, "min": one.minimum, "mean": one.mean, "max": one.maximum}
        result.setdefault(phase, {})[name_of(kind)] = numbers
    return result


def _sizes(one: Sizes) -> dict[str, Any]:
    rooms = {room: _size(size) for room, size in one.rooms.items()}
    return {"complete": _size(one.complete), "control": _size(one.control), "rooms": rooms}


def _size(size: Size) -> dict[str, int]:
    return {"text": size.text, "rodata": size.rodata, "data": size.data, "bss": size.bss}
