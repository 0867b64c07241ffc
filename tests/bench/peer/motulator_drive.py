"""One drive like axis 1 of the board in motulator and motulator-export, by their public interfaces.

Prints real-time factors as JSON: of motulator, of motulator-export, and of the compiled part of the latter without
Python. Runs in a separate environment with both packages and without this project.
"""

import json
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import motulator.drive.control.sm as control
from motulator.drive import model
from motulator_export import native

SAMPLE_S = 62.5e-6
SPEED = 100.0  # [rad/s]
SIMULATED_S = {"motulator": 0.1, "motulator-export": 2.0}


def drive(pwm: bool) -> tuple[Any, Any]:
    """Motor with converter (PWM edges or averaged), and speed control."""
    machine = model.SynchronousMachinePars(n_p=2, R_s=0.55, L_d=0.403e-3, L_q=0.512e-3, psi_f=0.0154)
    inertia = 8e-6
    plant = model.Drive(
        model.SynchronousMachine(machine),
        model.MechanicalSystem(J=inertia),
        model.VoltageSourceConverter(u_dc=24.0),
        pwm=pwm,
    )
    settings = control.CurrentVectorControllerCfg(i_s_max=4.0, alpha_c=6280.0, T_s=SAMPLE_S, sensorless=False)
    controller = control.VectorControlSystem(
        control.CurrentVectorController(machine, settings), control.SpeedController(J=inertia, alpha_s=300.0)
    )
    controller.set_speed_ref(SPEED)
    return plant, controller


def run(simulation: Any, seconds: float) -> float:
    """CPU time of a simulation [s]; the shaft must reach its speed."""
    begin = time.thread_time()
    results = simulation.simulate(t_stop=seconds)
    used = time.thread_time() - begin
    reached = float(results.mdl.mechanics.w_M[-1])
    if abs(reached - SPEED) > 0.05 * SPEED:
        raise RuntimeError(f"the drive turns at {reached:.1f} rad/s instead of {SPEED:.0f}")
    return used


class TimedSystem:
    """A system of motulator-export whose compiled part is timed."""

    def __init__(self, system: Any) -> None:
        self._system = system
        self.used_s = 0.0

    def __getattr__(self, name: str) -> Any:
        """All other attributes of the system."""
        return getattr(self._system, name)

    def run(self, until: float, points: int) -> int:
        """Simulate up to a time [s]."""
        begin = time.thread_time()
        status: int = self._system.run(until, points)
        self.used_s += time.thread_time() - begin
        return status


def in_python(pwm: bool, seconds: float) -> dict[str, float]:
    """Real-time factor of motulator."""
    return {"all": seconds / run(model.Simulation(*drive(pwm), show_progress=False), seconds)}


def compiled(pwm: bool, seconds: float) -> dict[str, float]:
    """Real-time factors of motulator-export, all of it and its compiled part."""
    plant, controller = drive(pwm)
    run(native.Simulation(plant, controller, show_progress=False), SAMPLE_S * 10000)  # compiles the library
    plant, controller = drive(pwm)
    simulation = native.Simulation(plant, controller, show_progress=False)
    make: Callable[..., Any] = simulation._system_type
    made: list[TimedSystem] = []

    def timed_system(*arguments: Any) -> TimedSystem:
        made.append(TimedSystem(make(*arguments)))
        return made[-1]

    simulation._system_type = timed_system
    whole = run(simulation, seconds)
    return {"all": seconds / whole, "compiled": seconds / made[0].used_s}


def main() -> int:
    """Measure both models of the inverter."""
    figures: dict[str, Any] = {}
    for package, measure in (("motulator", in_python), ("motulator-export", compiled)):
        seconds = SIMULATED_S[package]
        figures[package] = {
            "version": version(package),
            "averaged": measure(False, seconds),
            "switching": measure(True, seconds),
        }
    print(json.dumps(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
