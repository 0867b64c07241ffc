"""One drive like axis 1 of the board in motulator, by its public interface: prints real-time factors as JSON.

Runs in an environment of its own, which has motulator and nothing of this project.
"""

import json
import sys
import time

import motulator.drive.control.sm as control
from motulator.drive import model

SAMPLE_S = 62.5e-6
SPEED = 100.0  # [rad/s]


def factor(pwm: bool, seconds: float) -> float:
    """Simulated over used time of a drive that turns."""
    machine = model.SynchronousMachinePars(n_p=2, R_s=0.55, L_d=0.403e-3, L_q=0.512e-3, psi_f=0.0154)
    inertia = 8e-6
    drive = model.Drive(
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
    simulation = model.Simulation(drive, controller, show_progress=False)
    begin = time.thread_time()
    results = simulation.simulate(t_stop=seconds)
    used = time.thread_time() - begin
    reached = float(results.mdl.mechanics.w_M[-1])
    if abs(reached - SPEED) > 0.05 * SPEED:
        raise RuntimeError(f"the drive turns at {reached:.1f} rad/s instead of {SPEED:.0f}")
    return seconds / used


def main() -> int:
    """Measure both models of the inverter."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 0.1
    print(json.dumps({"averaged": factor(False, seconds), "switching": factor(True, seconds)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
