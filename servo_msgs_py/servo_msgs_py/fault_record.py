"""Record of the samples before the first fault of an axis, stored by the firmware (``axisN.fault_record``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.catalogue import Catalogue, Flag, Value, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS, TICK

_STRUCTURE: Final = "fault_record_t"
_MONITOR_PERIOD: Final = SLOW_PERIODS // 2
"""PWM period after a slow tick in which the firmware runs the monitors and samples (``firmware/app/servo.c``)."""

UNITS: Final = {
    "time": "s", "i_a": "A", "i_b": "A", "i_d": "A", "i_q": "A", "theta_e": "rad", "u_dc": "V", "speed": "rad/s",
}  # fmt: skip
"""Columns of `FaultRecord.samples` with units: time relative to the fault, phase currents, currents in rotor
coordinates, electrical angle, bus voltage, mechanical speed."""


def record_variable(axis: int) -> str:
    """Name of the record of an axis."""
    return f"{axis_name(axis)}.fault_record"


@dataclass(frozen=True)
class FaultRecord:
    """First fault of an axis and the samples of the preceding 32 ms, one per slow tick."""

    axis: int  # index of the axis
    fault: Flag | None  # the first fault; None if there is none
    tick: int  # PWM periods since reset
    place: str  # state at the fault, such as ``RUN/SPIN``
    samples: Trace  # columns `UNITS`; the last sample was taken in the period of the fault

    @classmethod
    def of(cls, axis: int, data: Value, catalogue: Catalogue) -> FaultRecord:
        """Decode the bytes of a record.

        Raises
        ------
        ValueError
            If it is not a record of this version.
        """
        members = catalogue.structs[_STRUCTURE]
        if not isinstance(data, bytes) or len(data) != sum(member.size for member in members):
            raise ValueError(f"{record_variable(axis)} is not a record of this version")
        raw: dict[str, list[int]] = {}
        for member in members:
            raw[member.name], data = member.decode_raw(data[: member.size]), data[member.size :]
        tick, code, state, substate, following, size = (
            raw[name][0] for name in ("tick", "code", "state", "substate", "next", "size")
        )
        rings = {m.name: np.array(raw[m.name]) * m.lsb for m in members if m.count > 1}
        flags = {flag.bit + 1: flag for flag in catalogue.flags["faults"]}
        label = catalogue.label("state_t", state)
        place = f"RUN/{catalogue.label('substate_t', substate)}" if label == "RUN" else label
        return cls(axis, flags.get(code), tick, place, _samples(tick, axis, following, size, rings))

    @property
    def seconds(self) -> float:
        """Time of the fault since the reset of the board [s]."""
        return self.tick * PERIOD_NS * 1e-9

    def summary(self) -> str:
        """Fault, state, time, speed, current and bus voltage as text."""
        if self.fault is None:
            return "no fault"
        text = f"{self.fault.name} in {self.place}, {self.seconds:.4f} s after reset"
        if not len(self.samples):
            return text
        last = {name: float(column[-1]) for name, column in self.samples.columns.items()}
        current = math.hypot(last["i_d"], last["i_q"])
        return f"{text}: {last['speed']:.1f} rad/s, {current:.2f} A, {last['u_dc']:.1f} V"

    def plain(self) -> dict[str, Any]:
        """Numbers and texts for JSON."""
        fault = self.fault
        return {
            "axis": axis_name(self.axis),
            "fault": None if fault is None else fault.name,
            "cause": None if fault is None else fault.cause,
            "remedy": None if fault is None else fault.remedy,
            "state": self.place,
            "tick": self.tick,
            "seconds": self.seconds,
            "columns": list(self.samples.columns),
            "samples": self.samples.table().tolist(),
        }


def _samples(tick: int, axis: int, following: int, size: int, rings: Mapping[str, NDArray[np.float64]]) -> Trace:
    capacity = len(rings["i_d"])
    size = min(size, capacity)
    order = (following - size + np.arange(size)) % capacity
    samples = {name: ring[order] for name, ring in rings.items()}
    # The last sample was taken in the period of the fault. A fault in the monitor period: axis 1 has no regular sample
    # in this period, the previous one is a slow tick older; axis 2 has one half a period earlier.
    periods = (tick - _MONITOR_PERIOD) % SLOW_PERIODS or (SLOW_PERIODS if axis == 0 else 0.5)
    since_monitor = periods * PERIOD_NS * 1e-9
    time = -since_monitor - TICK * np.arange(size - 2, -2, -1.0)
    time[-1:] = 0.0
    d, q, theta = samples["i_d"], samples["i_q"], samples["theta_e"]
    alpha, beta = d * np.cos(theta) - q * np.sin(theta), d * np.sin(theta) + q * np.cos(theta)
    i_b = -0.5 * alpha + math.sqrt(0.75) * beta
    columns = {"time": time, "i_a": alpha, "i_b": i_b, **samples}
    return Trace(0.0, {name: columns[name] for name in UNITS}, units=UNITS)
