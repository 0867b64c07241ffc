"""Calibration of the price list of the virtual core by counted instructions: one weight per file.

The cost program runs on the host with the charges of the virtual core (`servo_twin._core_time`), which are summed per
file; the inputs are bit-identical. The weights are a least-squares fit of the mean instructions of each interrupt and
loop, regularised towards one common weight, so that a file that no run determines has a plausible weight.

The committed weights stay while each mean that they charge is within `KEPT_WITHIN` of the one by a new fit: every
change of the firmware shifts the fit, single weights by up to 7 % where the runs determine only their sum, and with
other weights every run at level registers gives other numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_twin._core_time import COMMON, UNITS, charged, preprocessed, weight_of
from targets.machines import HostProgram
from targets.sources import ROOMS, Sources
from targets.toolchain import compile_objects, run

from firmware_cost.instructions import (
    EVERY_PHASE,
    FAST,
    OBSERVED_PHASE,
    PHASES,
    SLOW,
    Counts,
    Kind,
    Setup,
    image,
    parse,
)

_REGULARISATION: Final = 0.1
"""Regularisation of a weight towards the common one, relative to the relative error of a row."""
_WEIGHT_MIN: Final = 0.1
KEPT_WITHIN: Final = 0.03
"""Largest relative difference of the means that committed and fitted weights charge, with which the former stay.

Small against the error of the charges, of up to 10 % on average.
"""
_HOST: Final = ("gcc", "-std=gnu99", "-O1", "-w")
_WRAPPED: Final = ("axis_fast", "axis_slow")

Label = tuple[Setup, str, Kind]

_HEAD: Final = """\
# Instructions of a Cortex-M3 (-O2) for each one of the price list in _core_time.py, per file of the firmware: a fit of
# counted interrupts and loops. `make bench-firmware UPDATE=1` writes this file.

"""


@dataclass(frozen=True)
class Charging:
    """Cost program for the host, with charges instead of counted instructions."""

    files: tuple[str, ...]  # files of the firmware, such as ``control/pi``
    prices: tuple[tuple[str, float], ...]  # file and price of every charge [instructions]; equal charges share an entry
    interrupts: HostProgram  # program that counts the interrupts
    loops: HostProgram  # program that counts the loops

    @classmethod
    def build(cls, sources: Sources, folder: Path) -> Charging:
        """Compile the program, whose image contains the units of each charge.

        Parameters
        ----------
        sources : Sources
        folder : Path
            Folder of the build.

        Raises
        ------
        TargetError
            If it does not compile.
        """
        folder.mkdir(parents=True)
        prices: dict[tuple[str, float], int] = {}
        written: dict[str, Path] = {}
        for path in sources.core(ROOMS):
            name = f"{path.parent.name}/{path.stem}"
            body = charged(preprocessed(path, [sources.firmware]), str(path), _adder(prices, name))
            written[name] = folder / f"{name.replace('/', '_')}.c"
            written[name].write_text(f"extern unsigned core_units, core_price[];\n{body}", encoding="utf-8")
        objects = compile_objects(_HOST, list(written.values()), folder, folder)
        interrupts, loops = (_link(sources, folder, objects, len(prices), loops=loops) for loops in (False, True))
        return cls(tuple(written), tuple(prices), interrupts, loops)

    def charged(self, weights: Mapping[str, float]) -> dict[Setup, Counts]:
        """Units (1/16 instruction) that the virtual core charges, by setup."""
        units = [round(UNITS * weight_of(weights, name) * price) for name, price in self.prices]
        return {setup: self.count(setup, units) for setup in Setup}

    def count(self, setup: Setup, units: Sequence[int]) -> Counts:
        """Sum of the units of all charges, as `instructions.count`.

        Parameters
        ----------
        units : sequence of int
            Units of each of the `prices` [1/16 instruction].
        """
        phases = 1 << PHASES.index(OBSERVED_PHASE) if setup == Setup.WITHOUT_ENCODERS else EVERY_PHASE
        data = image(setup=setup, phases=phases) + np.array(units, "<u4").tobytes()
        inner = {label: value for label, value in parse(self.loops.run(data)).items() if label[1] in _LOOPS}
        outer = {label: value for label, value in parse(self.interrupts.run(data)).items() if label[1] not in _LOOPS}
        return {**outer, **inner}


_LOOPS: Final = (FAST, SLOW)


def _adder(prices: dict[tuple[str, float], int], name: str) -> Callable[[float], str]:
    return lambda price: f"(core_units += core_price[{prices.setdefault((name, price), len(prices))}])"


def _link(sources: Sources, folder: Path, objects: Sequence[Path], prices: int, *, loops: bool) -> HostProgram:
    bench = sources.root / "tests" / "bench" / "native"
    names = ["cost.c", "bench_board.c", "units.c", *(["cost_loops.c"] if loops else [])]
    machine = sources.native / "host"
    include = [f"-I{path}" for path in (bench / "host", bench, sources.firmware, sources.native, machine)]
    wrap = [f"-Wl,--wrap={name}" for name in (_WRAPPED if loops else ())]
    files = [*objects, *(bench / name for name in names), machine / "machine.c", sources.native / "text.c"]
    output = folder / ("loops" if loops else "interrupts")
    run([*_HOST, f"-DPRICES={prices}U", *include, *wrap, *files, "-o", output])
    return HostProgram(output)


@dataclass(frozen=True)
class Charges:
    """Charges of the price list without weights."""

    files: tuple[str, ...]  # files of the firmware
    mean: Mapping[Label, NDArray[np.float64]]  # instructions per file by setup, phase and kind, shape (files,)


def charges(charging: Charging) -> Charges:
    """Run the program once for each file and setup."""
    mean: dict[Label, list[float]] = {}
    for setup in Setup:
        for file in charging.files:
            units = [round(UNITS * price) if name == file else 0 for name, price in charging.prices]
            for (phase, kind), count in charging.count(setup, units).items():
                mean.setdefault((setup, phase, kind), []).append(count.mean / UNITS)
    return Charges(charging.files, {label: np.array(values) for label, values in mean.items()})


def fit(charge: Charges, counts: Mapping[Setup, Counts]) -> dict[str, float]:
    """Weight of each file, and the common weight of all other files under `COMMON`.

    Parameters
    ----------
    charge : Charges
    counts : mapping
        Counted instructions, by setup; setups, phases and kinds that are missing are ignored.
    """
    labels = [label for label in charge.mean if label[1:] in counts.get(label[0], {})]
    counted = np.array([counts[setup][phase, kind].mean for setup, phase, kind in labels])
    relative = np.array([charge.mean[label] for label in labels]) / counted[:, np.newaxis]
    common = 1.0 / float(np.mean(relative.sum(axis=1)))
    used = relative.max(axis=0) > 0.0
    free = used.copy()
    weight = np.full(len(charge.files), common)
    while True:
        size = int(free.sum())
        system = np.vstack([relative[:, free], _REGULARISATION * np.eye(size)])
        remainder = 1.0 - relative[:, ~free] @ weight[~free]
        weight[free] = np.linalg.lstsq(
            system, np.concatenate([remainder, np.full(size, _REGULARISATION * common)]), rcond=None
        )[0]
        low = free & (weight < _WEIGHT_MIN)
        if not low.any():
            break
        weight[low], free = _WEIGHT_MIN, free & ~low
    entries = zip(charge.files, weight, used, strict=True)
    return {COMMON: round(common, 3), **{name: round(float(value), 3) for name, value, part in entries if part}}


def kept(committed: Mapping[str, float], fitted: Mapping[str, float], charge: Charges) -> dict[str, float]:
    """The committed weights, if they charge about the same as the fitted ones; otherwise these.

    Parameters
    ----------
    committed, fitted : mapping
        As from `fit`. A file without a committed weight has the fitted one.
    charge : Charges
        To which `fitted` was fitted.
    """
    weights = {name: committed.get(name, value) for name, value in fitted.items()}
    means = np.array(list(charge.mean.values()))
    old, new = (means @ [weight_of(one, name) for name in charge.files] for one in (weights, fitted))
    return weights if (np.abs(old - new) <= KEPT_WITHIN * new).all() else dict(fitted)


def weights_text(weights: Mapping[str, float]) -> str:
    """Text of the committed file."""
    entries = "".join(f'"{name}" = {value:.3f}\n' for name, value in weights.items() if name != COMMON)
    return f"{_HEAD}{COMMON} = {weights[COMMON]:.3f} # of files that no run is in\n\n[weights]\n{entries}"
