"""True state of the plant of a virtual board."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, NamedTuple, get_type_hints

from servo_msgs_py.quantity import Quantity


class Truth(NamedTuple):
    """True state of the plant, in the order of the C structure ``board_truth_t``.

    Instantaneous values, except where noted: at level ``registers`` at `Board.time_ns` (steps of 10 ns), at level
    ``ideal`` at the end of the last half PWM cycle (31.25 us). Temperatures are updated every 1 ms. The mean voltages
    are those of the last complete PWM period at level ``registers`` (62.5 us, counted from power-on), of the last half
    cycle at level ``ideal``.
    """

    theta_m: Annotated[float, Quantity(unit="rad", text="mechanical angle, not wrapped")]
    omega_m: Annotated[float, Quantity(unit="rad/s", text="mechanical speed")]
    i_d: Annotated[float, Quantity(unit="A", text="current of the d axis; with PWM ripple at level registers")]
    i_q: Annotated[float, Quantity(unit="A", text="current of the q axis; with PWM ripple at level registers")]
    torque_e: Annotated[float, Quantity(unit="N m", text="air-gap torque of these currents")]
    impulse_e: Annotated[float, Quantity(unit="N m s", text="integral of the air-gap torque since power-on")]
    t_sink: Annotated[float, Quantity(unit="deg C", text="temperature of the axis' power stage")]
    t_winding: Annotated[float, Quantity(unit="deg C", text="temperature of the motor's winding")]
    u_dc: Annotated[float, Quantity(unit="V", text="bus voltage")]
    e_brake: Annotated[float, Quantity(unit="J", text="energy dissipated in the brake resistor since power-on")]
    t_brake: Annotated[float, Quantity(unit="deg C", text="temperature of the brake resistor")]
    u_a: Annotated[float, Quantity(unit="V", text="mean voltage of terminal a against the midpoint of u_dc")]
    u_b: Annotated[float, Quantity(unit="V", text="mean voltage of terminal b against the midpoint of u_dc")]
    u_c: Annotated[float, Quantity(unit="V", text="mean voltage of terminal c against the midpoint of u_dc")]
    brake_holds: Annotated[float, Quantity(text="1: the holding brake is closed, 0: it is open")]
    theta_load: Annotated[float, Quantity(unit="rad", text="angle of the second mass; without one, of the rotor")]
    omega_load: Annotated[float, Quantity(unit="rad/s", text="speed of the second mass; without one, of the rotor")]
    torque_shaft: Annotated[float, Quantity(unit="N m", text="torque between rotor and second mass, mean of a step")]
    t_magnet: Annotated[float, Quantity(unit="deg C", text="temperature of the magnet")]
    r_s: Annotated[float, Quantity(unit="ohm", text="resistance at these temperatures")]
    psi_m: Annotated[float, Quantity(unit="V s", text="flux linkage of the magnet at these temperatures")]
    l_d: Annotated[float, Quantity(unit="H", text="inductance for small changes of i_d")]
    l_q: Annotated[float, Quantity(unit="H", text="inductance for small changes of i_q")]


QUANTITIES: Final[Mapping[str, Quantity]] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(Truth, include_extras=True).items()
}
"""Unit and description of each number of `Truth`."""
