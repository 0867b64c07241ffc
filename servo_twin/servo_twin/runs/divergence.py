"""How the twin departs from the board: first difference of each variable, and when it exceeds the noise.

A run that the twin repeats from the reset, of a virtual board whose seed and plant are known, is compared bit for bit.
Otherwise only what the diagnosis of the live twin takes for more than noise counts: the running means of
`SignalMonitor`, and the faults, once board and twin have agreed after a synchronisation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.diagnosis.change_detector import Estimate
from servo_twin.diagnosis.monitor import DiagnosisMonitor, LocatedFinding
from servo_twin.diagnosis.signal_monitor import MONITORED
from servo_twin.diagnosis.thresholds import Thresholds as DiagnosisThresholds
from servo_twin.lockstep.twin import Pair
from servo_twin.plant import PlantConfig

_HISTORY: Final = 10.0  # board time before the first difference that the diagnosis is given [s]
_AGREED: Final = 0.8  # time without a difference after which board and twin have agreed [s]
_NEVER: Final = 10.0  # time after a synchronisation within which they must have agreed [s]
_ESTIMATE_AGE: Final = 2.0  # age of the estimates "before" at the first difference within noise [s]


def noise_bands(thresholds: DiagnosisThresholds, supply: float) -> dict[str, float]:
    """Largest difference of a healthy pair by variable [SI]; others have none.

    Parameters
    ----------
    thresholds : DiagnosisThresholds
        Of a calibration.
    supply : float
        Nominal bus voltage [V].
    """
    bands = {"u_dc": supply * thresholds.bus_noise * 5.0}
    for axis, noise in enumerate(thresholds.axes):
        for signal, limit in zip(MONITORED, noise.means, strict=True):
            bands[f"{axis_name(axis)}.{signal}"] = bands[f"{axis_name(axis)}.{signal}_ref"] = limit
        bands[f"{axis_name(axis)}.i_d"] = bands[f"{axis_name(axis)}.i_q"]
    return bands


Estimates = Mapping[tuple[int | None, str], Estimate]
"""Estimates of the plant by axis (None: the bus) and change."""


@dataclass
class Departure:
    """One variable that differs."""

    variable: str
    tick: int  # first tick of a difference: any in a comparison bit for bit, else one beyond the noise
    left: int | None  # first tick beyond the noise; None: it stays within
    first: float  # difference board - twin at `left`, else at `tick` [SI]
    value: float  # of the board then [SI]
    largest: float  # difference of the largest magnitude [SI]
    noise: float  # largest difference of a healthy pair [SI]; 0: not known
    unit: str

    @property
    def ratio(self) -> float:
        """Largest difference in units of the noise; infinite if that is not known."""
        return abs(self.largest) / self.noise if self.noise else float("inf")


class Divergence:
    """Collects the departures, with a diagnosis of the plant.

    Parameters
    ----------
    plant : PlantConfig
        Of the twin.
    calibrated : DiagnosisThresholds
        Noise of a healthy pair.
    catalogue : Catalogue
        For the units.
    """

    def __init__(
        self,
        plant: PlantConfig,
        calibrated: DiagnosisThresholds,
        catalogue: Catalogue,
    ) -> None:
        self.monitor = DiagnosisMonitor(plant, calibrated)
        self.departures: dict[str, Departure] = {}
        self.before: Estimates = {}  # estimates before the first departure
        self.first: int | None = None  # first tick of a difference; None: none
        self._begin: int | None = None  # first tick since the synchronisation
        self._agreed_from: int | None = None  # first tick of the present agreement, before `_agreed`
        self._agreed = False  # board and twin have agreed since the synchronisation
        self._bands = noise_bands(calibrated, plant.bus.u_source)
        self._catalogue = catalogue
        self._same: deque[Pair] = deque()  # newest identical pairs, of a comparison bit for bit
        self._history: deque[tuple[int, Estimates]] = deque()

    def add(self, pair: Pair, *, exact: bool) -> None:
        """Compare a pair; `exact`: bit for bit."""
        if exact:
            if self.first is None and pair.twin.items() <= pair.real.items():
                self._same.append(pair)
                if pair.tick - self._same[0].tick > _ticks(_HISTORY):
                    self._same.popleft()
                return
            differing = [name for name, value in pair.twin.items() if pair.real[name] != value]
            self._flush()
            for name in differing:
                size = pair.real[name] - pair.twin[name]
                self._depart(pair, name, size, beyond=abs(size) > self._bands.get(name, 0.0))
            self._diagnose(pair)
            return
        self._flush()
        if self._diagnose(pair):
            self._remember(pair.tick)
        beyond = self._beyond(pair)
        for name in {*beyond, *self.departures}:
            if name in pair.twin:
                self._depart(pair, name, pair.real[name] - pair.twin[name], beyond=name in beyond)

    def _diagnose(self, pair: Pair) -> bool:
        """As `DiagnosisMonitor.update`, but a fault does not discard what was found before it: it is a consequence."""
        if pair.fault and self.monitor.findings():
            self.monitor.interrupt()
            return False
        return self.monitor.update(pair)

    def _beyond(self, pair: Pair) -> set[str]:
        """Variables beyond the noise; none before board and twin have agreed, except if they never do."""
        if pair.difference:
            self._agreed_from = None
            return set()
        faults = (f"{axis_name(axis)}.faults" for axis in range(AXES))
        beyond = {name for name in faults if name in pair.twin and pair.twin[name] != pair.real[name]}
        beyond |= {*self.monitor.signals.beyond}
        if self._begin is None:
            self._begin = pair.tick
        if beyond and not self._agreed:
            self._agreed_from = None
            return beyond if pair.tick - self._begin > _ticks(_NEVER) else set()
        if self._agreed_from is None:
            self._agreed_from = pair.tick
        self._agreed = self._agreed or pair.tick - self._agreed_from > _ticks(_AGREED)
        return beyond if self._agreed else set()

    def interrupt(self) -> None:
        """The next pair does not follow on the last one: the twin was synchronised again."""
        self._flush()
        self.monitor.interrupt()
        self._begin = self._agreed_from = None
        self._agreed = False

    def findings(self) -> list[LocatedFinding]:
        """Changes of the plant at the end."""
        return self.monitor.findings()

    def ordered(self) -> list[Departure]:
        """Departures in the order of their first difference; those of the same sample by when they left the noise."""
        never = 1 << 63
        return sorted(self.departures.values(), key=lambda d: (d.tick, never if d.left is None else d.left, -d.ratio))

    def _flush(self) -> None:
        """Give the diagnosis the identical pairs before the first difference."""
        if not self._same:
            return
        while self._same:
            self.monitor.update(self._same.popleft())
        self.before = self.monitor.estimates()

    def _remember(self, tick: int) -> None:
        """Keep the estimates until they are older than any sign of the first departure."""
        if self.first is None:
            self._history.append((tick, self.monitor.estimates()))
            while len(self._history) > 1 and tick - self._history[1][0] > _ticks(_ESTIMATE_AGE):
                self._history.popleft()
            self.before = self._history[0][1]

    def _depart(self, pair: Pair, name: str, size: float, *, beyond: bool) -> None:
        if self.first is None:
            self.first = pair.tick
        known = self.departures.get(name)
        if known is None:
            noise, unit = self._bands.get(name, 0.0), self._catalogue[name.partition("[")[0]].unit
            known = Departure(name, pair.tick, None, size, pair.real[name], size, noise, unit)
            self.departures[name] = known
        if beyond and known.left is None:
            known.left, known.first, known.value = pair.tick, size, pair.real[name]
        known.largest = max(known.largest, size, key=abs)


def _ticks(seconds: float) -> int:
    return round(seconds * 1e9 / PERIOD_NS)
