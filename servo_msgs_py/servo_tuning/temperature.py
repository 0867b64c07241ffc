"""The group [board.temperature]: characteristic of the heat sink sensors and fault threshold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from servo_tuning.errors import ConfigError, refused
from servo_tuning.schema import check_table, unknown_name

_CODES: Final = 4096
_LINEAR: Final = ((0.0, 0.0), (150.0, float(_CODES)))
_DEFAULTS: Final[Mapping[str, object]] = {"threshold_c": 85.0, "hysteresis_c": 15.0, "table": _LINEAR}
_POINT: Final = 2


@dataclass(frozen=True)
class Temperature:
    """Fault threshold of the heat sinks, and characteristic of their sensors."""

    threshold: float  # [deg C]
    hysteresis: float  # [K]
    table: Sequence[tuple[float, float]]
    """Temperature [deg C] and ADC code: linear interpolation, codes strictly monotonic (falling for an NTC in a
    divider)."""

    @classmethod
    def of(cls, value: object) -> Temperature:
        """Check the group; omitted entries have defaults.

        Raises
        ------
        ConfigError
            If an entry is unknown or out of range.
        """
        given = check_table("board.temperature", value)
        for name in given:
            if name not in _DEFAULTS:
                raise unknown_name(f"board.temperature.{name}", name, _DEFAULTS)
        entries = {**_DEFAULTS, **given}
        threshold, hysteresis = (_number(key, entries[key]) for key in ("threshold_c", "hysteresis_c"))
        if hysteresis <= 0.0:
            raise refused("board.temperature.hysteresis_c", hysteresis, "not above 0", "write about 15 K")
        table = _points(entries["table"])
        for celsius in (threshold, threshold - hysteresis):
            if not table[0][0] <= celsius <= table[-1][0]:
                raise refused(
                    "board.temperature.threshold_c",
                    threshold,
                    f"{celsius:g} deg C is outside the table of the sensor",
                    f"keep threshold and threshold minus hysteresis within {table[0][0]:g} .. {table[-1][0]:g} deg C",
                )
        result = cls(threshold, hysteresis, table)
        hot, cool = result.codes()
        if hot == cool:
            raise refused("board.temperature.hysteresis_c", hysteresis, "less than one code", "raise it")
        return result

    def codes(self) -> tuple[int, int]:
        """ADC codes of the threshold and of the threshold minus the hysteresis."""
        return self._code(self.threshold), self._code(self.threshold - self.hysteresis)

    def _code(self, celsius: float) -> int:
        for (t0, c0), (t1, c1) in pairwise(self.table):
            if t0 <= celsius <= t1:
                return min(round(c0 + (c1 - c0) * (celsius - t0) / (t1 - t0)), _CODES - 1)
        raise AssertionError(f"{celsius} is outside the table")


def _number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise refused(f"board.temperature.{key}", repr(value), "not a finite number", "write degrees Celsius")
    return float(value)


def _points(value: object) -> Sequence[tuple[float, float]]:
    where = "board.temperature.table"
    wrong = ConfigError(
        f"{where}: write [[celsius, code], ...] with rising temperatures and strictly monotonic codes 0 .. {_CODES}"
    )
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) < _POINT:
        raise wrong
    points: list[tuple[float, float]] = []
    for point in value:
        if not isinstance(point, Sequence) or isinstance(point, str) or len(point) != _POINT:
            raise wrong
        points.append((_number("table", point[0]), _number("table", point[1])))
    steps = [(t1 - t0, c1 - c0) for (t0, c0), (t1, c1) in pairwise(points)]
    rising = steps[0][1] > 0
    if any(dt <= 0 or dc == 0 or (dc > 0) != rising for dt, dc in steps):
        raise wrong
    if not all(0 <= code <= _CODES for _, code in points):
        raise wrong
    return points
