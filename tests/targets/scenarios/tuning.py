"""Changes of the configuration at rest and in motion, and refused changes."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import BlockRefusedError, read_block, send_block, take_blocks

from targets.rig import Rig
from targets.scenarios.parts import POSITION, SPEED, TORQUE, features, ready, spin, stop
from targets.server_requests import log_request

_TABLE: Final = AxisConfigTable.load()


def scaled(rig: Rig, changed: Mapping[int, Mapping[str, float]]) -> None:
    """Send the blocks of axes with some members multiplied by factors, and take them."""
    for axis, factors in changed.items():
        block = read_block(rig, axis)
        send_block(rig, axis, block | {path: round(block[path] * factor) for path, factor in factors.items()})
    take_blocks(rig, list(changed))


def tuning(rig: Rig) -> None:
    """Blocks of both axes at rest, gains in motion with every estimator, and every refusal."""
    ready(rig)
    defaults = dict.fromkeys(("speed_limit", "acceleration_limit", "i_q_limit", "following_error", "over_speed"), 0.9)
    defaults |= {"position_limit": 0.5, "features": 0.5, "stop.disable": 0.5, "stop.quick_stop": 0.4}
    scaled(rig, {0: {**defaults, "torque_constant": 0.95, "stop_ticks_max": 1.1}, 1: {"u_dc_max": 0.99}})
    scaled(rig, {0: dict.fromkeys(("speed_limit", "acceleration_limit", "i_q_limit"), 1.1)})
    block = read_block(rig, 1)
    send_block(rig, 1, block | {"feedback": 1, "encoder.counts": 8000, "encoder.angle_per_count": 2**29 // 1000})
    take_blocks(rig, [1])
    send_block(rig, 1, block)
    take_blocks(rig, [1])

    _refusals(rig, block)
    rig.set("param.features", features("FRICTION", "SPEED_OBSERVER", "ACCELERATION_FORWARD"), features("ANGLE_CHECK"))
    spin(rig)
    rig.set("cmd.mode", SPEED, POSITION)
    rig.set("cmd.speed", 60.0, 0.0)
    rig.set("cmd.position", 0.0, 3.0)
    rig.run(0.04)
    gains = ("speed.kp", "current_loop.q.kp", "current_loop.d.kp", "current_loop.omega_psi", "friction.viscous")
    shaft = ("speed_observer.acceleration_per_current", "pll.acceleration", "path_omega_n_ts", "acceleration_forward")
    scaled(rig, {axis: {**dict.fromkeys(gains, 0.8), **dict.fromkeys(shaft, 1.1)} for axis in (0, 1)})
    scaled(rig, {1: {"position_gain": 0.999}, 0: {"position_gain": 1.5}})
    with suppress(BlockRefusedError):
        scaled(rig, {0: {"u_dc_max": 0.98}})
    rig.run(0.03)
    stop(rig)


def hot_winding(rig: Rig) -> None:
    """A falling nominal heat capacity of a winding: derating, limit at the rated current, fault, and recovery."""
    step = 0.034  # step of the thermal model [s]
    rig.set("param.features", features("WINDING_MODEL"), features())
    spin(rig)
    scaled(rig, {0: {"winding_model.derating": 0.9}})
    rig.run(step)
    rig.set("cmd.mode", TORQUE, POSITION)
    rig.set("cmd.i_q", 4.0, 0.0)
    rig.run(0.002)
    rig.set("cmd.mode", SPEED, POSITION)
    rig.set("cmd.speed", 200.0, 0.0)
    rig.run(0.005)
    rig.set("cmd.mode", TORQUE, POSITION)
    rig.set("param.features", features(), features())  # waits for a set-point
    rig.run(0.002)
    rig.set("cmd.i_q", 0.1, 0.0)
    rig.run(0.002)
    rig.set("param.features", features("WINDING_MODEL"), features())
    scaled(rig, {0: {"winding_model.maximum": 0.7}})
    rig.run(step)
    scaled(rig, {0: {"winding_model.fault": 0.7}})
    rig.until("a hot winding", lambda: "MOTOR_TEMPERATURE" in rig.faults(0))
    scaled(rig, {0: {"winding_model.maximum": 1.4, "winding_model.fault": 1.4}})
    rig.run(step)
    rig.set("cmd.clear_faults", 1, 0)
    rig.until("cleared", lambda: rig.states()[0] == "STOP")


def _refusals(rig: Rig, block: dict[str, int]) -> None:
    words = _TABLE.words(block)
    wrong_checksum = [1, len(_TABLE), 1, 0]
    for part in (
        [2, 0, 0], [0, -1, 0], [0, 0, 25, 0], [0, 0, 2, 0], [0, 0, 1, -1], [0, 0],
        [1, list(block).index("stop.ramp"), 1, 1], [1, len(_TABLE) - 1, 3, 0, 0, 0], wrong_checksum,
    ):  # fmt: skip
        rig.write_words("config.window", part)
    for axes in (0, 4, 2):
        rig.write_words("config.take", [axes])
    for busy in (("config.take", [2]), ("config.window", [1, 0, 1, words[0]]), ("config.window", wrong_checksum)):
        for later in (0.0, 1.2e-4, 2.4e-4, 3.6e-4):  # one of them is early in a slow tick
            send_block(rig, 1, block)
            rig.run(later)
            # A request that arrives before the answer to the previous one is lost: the second one.
            rig.together(("config.take", [2]), ("config.take", [2]), busy)
            rig.run(0.001)


def measured(rig: Rig) -> None:
    """Sessions with other blocks and parameters, and each end: a silent host, another session, a stop, the host."""

    def changed() -> None:
        """A session that has changed configuration, parameters and mode of axis 1."""
        rig.set_raw("measurement.axis", 1)
        rig.set("param.faults_enabled", 0, 0)
        rig.set_raw("cmd.mode", SPEED, POSITION)
        scaled(rig, {0: {"u_dc_max": 0.99, "i_q_limit": 0.9}})

    def restored() -> None:
        rig.until("restored", lambda: rig.read_words("measurement.state") == [0])

    for token in (1, 2):  # the second one is refused
        rig.set_raw("boot_token", token)
    ready(rig)
    changed()
    rig.run(0.51)
    restored()
    for number in range(6):
        rig.send(log_request(number))
    changed()
    with suppress(BlockRefusedError):
        scaled(rig, {1: {"u_dc_max": 0.99}})
    rig.set_raw("storage.request", 1, 1)
    rig.set_raw("measurement.axis", 2)  # ends the session of axis 1
    restored()
    changed()
    rig.set("cmd.enable", 1, 0)
    rig.until("SPIN", lambda: rig.states()[0] == "SPIN")
    rig.command("QUICK_STOP")
    rig.set("cmd.enable", 1, 0)  # refused until the axis is off
    restored()
    rig.until("STOP", lambda: rig.states() == ["STOP", "STOP"])
    rig.set_raw("measurement.axis", 3)
    block = read_block(rig, 1)
    for later in (0.0, 1.2e-4, 2.4e-4, 3.6e-4):  # as in `_refusals`
        send_block(rig, 1, block)
        rig.run(later)
        rig.together(("config.take", [2]), ("config.take", [2]), ("measurement.axis", [2]))
        rig.run(0.001)
        rig.set_raw("measurement.axis", 0)
        restored()
