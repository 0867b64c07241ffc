"""Test rig: the diagnosis as a separate library, with the configuration of the first motor."""

from __future__ import annotations

from typing import Any, Final

from c_declarations import declarations
from firmware_compiler import FIRMWARE, CompileC

SENSOR, PHASE, CURRENT, ENCODER, ANGLE = (1 << bit for bit in range(5))  # SUSPECT_ bits
DEAD_TIME, BUS_COMPENSATION, FOLLOWING_ERROR, OVER_SPEED = 8, 4, 256, 512  # FEATURE_ bits
SILENT, DIRECTION_MIN, EMF_FLOOR, RESISTANCE, ABRUPT_COUNTS = 636, 318, 1208, 0.1875, 8

_HEADERS: Final = ("diagnosis/diagnosis.h", "diagnosis/fault_isolate.h", "diagnosis/fault_latch.h")
_OTHERS: Final = ("math/trig.c", "sensing/rotor_follow.c", "test/diagnosis_inlines.c")


def _length(x: int, y: int) -> int:
    """Length of a vector by the approximation of the firmware."""
    a, b = abs(x), abs(y)
    return max(a, b) + min(a, b) // 2


class Diagnosis:
    """Monitors of one axis with their observation (input) and evidence (output)."""

    def __init__(self, compile_c: CompileC) -> None:
        sources = [str(path.relative_to(FIRMWARE)) for path in sorted((FIRMWARE / "diagnosis").glob("*.c"))]
        self.ffi, lib = compile_c("diagnosis", [*sources, *_OTHERS], declarations(*_HEADERS))
        self.lib: Any = lib
        self.monitors: Any = self.ffi.new("diagnosis_t *")
        self.seen: Any = self.ffi.new("observation_t *")
        self.seen.abrupt_counts = ABRUPT_COUNTS
        self.shaft_seen: Any = self.ffi.new("shaft_observation_t *")
        self.evidence: Any = self.ffi.new("evidence_t *")
        winding = (SILENT, DIRECTION_MIN, round(RESISTANCE * 2**24), 5856774, EMF_FLOOR, 8195)
        self.winding: Any = self.ffi.new("winding_config_t *", winding)
        self.loop: Any = self.ffi.new("current_loop_config_t *", {"omega_l_d": 2413749, "omega_l_q": 3066599})
        self.search: Any = self.ffi.new(
            "rotor_search_config_t *",
            {
                "move_counts": 3,
                "current_limit": 15888,
                "follow": {"ticks": 200, "step": 109, "inductive": 52, "flux_min": 209631},
            },
        )

    def finding(self, name: str) -> int:
        """Bit of a finding."""
        return 1 << int(getattr(self.lib, f"FINDING_{name}"))

    def names(self) -> set[str]:
        """Names of the findings of the last step."""
        prefix = "FINDING_"
        known = [name for name in dir(self.lib) if name.startswith(prefix)]
        return {n.removeprefix(prefix) for n in known if self.evidence.confirmed >> getattr(self.lib, n) & 1}

    def _step(self, step: Any, monitor: str, *config: object) -> set[str]:
        self.evidence[0] = self.ffi.new("evidence_t *")[0]
        step(self.ffi.addressof(self.monitors, monitor), *config, self.seen, self.evidence)
        self.seen.current_change = 0
        return self.names()

    def current(self, d: int, q: int) -> None:
        """Set the current of the next steps."""
        self.seen.current_change = _length(d - self.seen.current.d, q - self.seen.current.q)
        self.seen.current = (d, q)
        self.seen.current_magnitude = _length(d, q)
        self.seen.drop = int(self.seen.current_magnitude * RESISTANCE)

    def sensor(self, phase: int, code: int, *, zero: int = 2048) -> set[str]:
        samples = self.ffi.new("idle_sample_t[2]", [(phase, code, zero, True), (0, 0, 0, False)])
        self.evidence[0] = self.ffi.new("evidence_t *")[0]
        monitor = self.ffi.addressof(self.monitors, "current_sense")
        self.lib.current_sense_monitor_step(monitor, samples, self.seen.switching, self.evidence)
        return self.names()

    def phase(self) -> set[str]:
        return self._step(self.lib.phase_monitor_step, "phase", self.winding)

    def encoder(self, count: int = 0, kp: int = 1 << 24) -> set[str]:
        self.seen.count = count
        return self._step(self.lib.encoder_monitor_step, "encoder", self.winding, kp)

    def angle(self) -> set[str]:
        self.monitors.angle.conducting_phases |= self.seen.conducting_phases
        return self._step(self.lib.angle_monitor_step, "angle", self.winding, self.loop)

    def heat(self, hot: int, cool: int, code: int) -> set[str]:
        self.seen.temperature = code
        return self._step(
            self.lib.heat_sink_monitor_step, "heat_sink", self.ffi.new("heat_sink_monitor_config_t *", (hot, cool))
        )

    def shaft(self, **config: int) -> set[str]:
        limits = {"runaway_margin": 1000, "runaway_ticks_max": 4, "stall_ticks_max": 5}
        limits |= {"following_ticks_max": 6, "over_speed_ticks_max": 7, **config}
        configuration = self.ffi.new("shaft_monitor_config_t *", limits)
        monitor = self.ffi.addressof(self.monitors, "shaft")
        self.evidence.confirmed = self.lib.shaft_monitor_step(monitor, configuration, self.shaft_seen)
        return self.names()

    def oscillation(self, current: int, swing: int = 1000) -> bool:
        monitor = self.ffi.addressof(self.monitors, "oscillation")
        monitor.swing_min = swing
        return bool(self.lib.oscillation_monitor_step(monitor, current))

    def stall_start(self, i_q: int) -> None:
        self.seen.current_ref.q = i_q
        self.lib.stall_test_start(self.ffi.addressof(self.monitors, "stall"), self.search, self.seen)

    def stall(self, count: int = 0) -> set[str]:
        self.seen.count = count
        return self._step(self.lib.stall_test_step, "stall", self.search)

    def suspect(self) -> Any:
        """Present suspicions."""
        evidence = self.ffi.new("evidence_t *")
        self.lib.diagnosis_suspect(self.monitors, self.winding, self.seen, evidence)
        return evidence
