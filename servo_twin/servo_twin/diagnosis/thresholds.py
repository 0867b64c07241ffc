"""Thresholds of the diagnosis: noise and model error of every signal of a healthy pair, detection threshold.

`servo_twin calibrate` measures them with a healthy board and writes a file. The packaged files are from ``servo-sim
calibrate`` with virtual pairs: ``thresholds.toml`` at level registers, ``thresholds_ideal.toml`` at level ideal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.text_file import TextFileError, read_toml

from servo_twin.diagnosis.signal_monitor import MONITORED
from servo_twin.diagnosis.signals import ALIASES, CHANGES, EQUATIONS, RESISTANCE, VOLTAGE_Q, AxisEquations
from servo_twin.diagnosis.window import Rows
from servo_twin.level import DEFAULT_LEVEL, Level

_PACKAGED: Final[Mapping[Level, Path]] = {
    "registers": Path(__file__).with_name("thresholds.toml"),
    "ideal": Path(__file__).with_name("thresholds_ideal.toml"),
}

CURRENTS: Final = (0.1, 0.3, 0.6)
SPEEDS: Final = (30.0, 60.0, 100.0, 150.0)
"""Limits of the bins of the voltage noise [A], [rad/s]: the residual error of the dead-time compensation is largest at
small currents and causes a ripple that increases with the speed."""

_Array = NDArray[np.float64]

_RIPPLE: Final = 0.3
"""Effective number of independent samples per sample of u_d, and of u_q at small currents: the dead-time ripple (six
periods per electrical revolution) is aliased to beats over several samples."""


class ThresholdsError(ValueError):
    """Invalid threshold file; the message contains the name of the value."""


@dataclass(frozen=True)
class AxisNoise:
    """Noise and model error of the equations of one axis (`servo_twin.diagnosis.signals`), with a healthy board."""

    alias: tuple[float, ...]  # coefficients of the aliasing error, per entry of `ALIASES`
    torque: float  # standard deviation of the torque equation [N m]
    voltage_q: tuple[float, ...]  # standard deviation by bin of `CURRENTS`, within it of `SPEEDS` [V]
    voltage_d: tuple[float, ...]  # standard deviation by bin, as `voltage_q` [V]
    baseline: tuple[float, ...]  # estimates of the unknowns without a change: model error of the twin
    spread: tuple[float, ...]  # standard deviation of an estimate relative to white noise, per unknown
    unexplained: tuple[float, ...]  # largest mean square of the residual relative to its variance, per equation
    means: tuple[float, ...]  # largest running mean, per signal of `servo_twin.diagnosis.signal_monitor.MONITORED`

    @property
    def prior(self) -> _Array:
        """Inverse variances of the alias coefficients: standard deviation of 100 % of the coefficient."""
        size = np.maximum(np.abs(np.array(self.alias)), 1e-9)
        return np.asarray(1.0 / size**2)

    def rows(self, samples: Sequence[AxisEquations]) -> Rows:
        """Weighted equations without aliasing and model error; the alias coefficients remain as nuisance unknowns."""
        y, phi, alias, share, current, speed, error = (np.array(part) for part in zip(*samples, strict=True))
        voltages = np.array([self.voltage_q, self.voltage_d])[:, bin_of(current, speed)]
        part = np.where(phi[:, VOLTAGE_Q, RESISTANCE] != 0.0, 1.0, _RIPPLE)
        independent = np.stack([share, part * phi[:, VOLTAGE_Q].any(axis=1), np.full_like(part, _RIPPLE)], axis=1)
        variance = np.stack([np.full(len(share), self.torque**2), *(voltages**2 + error**2)], axis=1)
        y = y - alias @ np.array(self.alias) - phi @ np.array(self.baseline)
        return Rows(y, np.concatenate([phi, alias], axis=2), independent / variance, independent)


def bin_of(current: _Array, speed: _Array) -> NDArray[np.int64]:
    """Indices of the bins of the voltage noise for currents [A] and speeds [rad/s]."""
    return np.searchsorted(CURRENTS, current) * (len(SPEEDS) + 1) + np.searchsorted(SPEEDS, speed)


BINS: Final = (len(CURRENTS) + 1) * (len(SPEEDS) + 1)

_LENGTHS: Final = {
    "alias": len(ALIASES),
    "voltage_q": BINS,
    "voltage_d": BINS,
    "baseline": len(CHANGES),
    "spread": len(CHANGES),
    "unexplained": len(EQUATIONS),
    "means": len(MONITORED),
}


@dataclass(frozen=True)
class Thresholds:
    """Results of a calibration."""

    axes: tuple[AxisNoise, ...]
    bus_noise: float  # relative standard deviation of the difference of the bus voltages
    bus_baseline: float  # relative mean of the difference of the bus voltages
    detect: float  # detection threshold of the log likelihood ratio
    false_alarm_hours: float  # mean time between false alarms at `detect`, extrapolated [h of motion]
    run_hours: float  # duration of the run [h]

    def bus_rows(self, voltages: Sequence[float]) -> Rows:
        """Equations of relative differences of the bus voltages."""
        y = np.array(voltages)[:, None] - self.bus_baseline
        ones = np.ones_like(y)
        return Rows(y, ones[:, :, None], ones * self.bus_noise**-2, ones)

    @classmethod
    def load(cls, path: Path | str | None = None, level: Level = DEFAULT_LEVEL) -> Thresholds:
        """Read a file; by default the packaged file of this level.

        Raises
        ------
        ThresholdsError
            If a value is missing or not a number.
        OSError
            If the file cannot be read.
        """
        return _packaged(level) if not path else _load(Path(path))

    def text(self) -> str:
        """Contents of a threshold file."""
        lines = [
            "# Written by `servo_twin calibrate` or `servo-sim calibrate`; units: diagnosis/thresholds.py",
            "",
        ]
        lines += _lines({k: v for k, v in asdict(self).items() if k != "axes"})
        for number, axis in enumerate(self.axes):
            lines += ["", f"[{axis_name(number)}]", *_lines(asdict(axis))]
        return "\n".join(lines) + "\n"


def _lines(entries: Mapping[str, Any]) -> list[str]:
    def number(value: float) -> str:
        return f"{value:.6g}" if value != int(value) else f"{value:.1f}"

    return [
        f"{name} = [{', '.join(map(number, value))}]" if isinstance(value, Sequence) else f"{name} = {number(value)}"
        for name, value in entries.items()
    ]


@cache
def _packaged(level: Level) -> Thresholds:
    return _load(_PACKAGED[level])


def _load(path: Path) -> Thresholds:
    try:
        table = read_toml(path)
        axes = tuple(_axis(table.pop(axis_name(number))) for number in range(AXES))
        names = [field.name for field in fields(Thresholds) if field.name != "axes"]
        return Thresholds(axes, **{name: _number(name, table[name]) for name in names})
    except (TextFileError, TypeError) as error:
        raise ThresholdsError(f"{path}: {error}") from None
    except KeyError as error:
        raise ThresholdsError(f"{path}: {error.args[0]} is missing; repeat `servo_twin calibrate`") from None
    except ThresholdsError as error:
        raise ThresholdsError(f"{path}: {error}") from None


def _axis(table: Mapping[str, Any]) -> AxisNoise:
    values: dict[str, Any] = {"torque": _number("torque", table["torque"])}
    for name, length in _LENGTHS.items():
        if not isinstance(table[name], list) or len(table[name]) != length:
            raise ThresholdsError(f"{name} is not a list of {length} numbers")
        values[name] = tuple(_number(name, value) for value in table[name])
    return AxisNoise(**values)


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise ThresholdsError(f"{name}: {value!r} is not a number")
    return float(value)
