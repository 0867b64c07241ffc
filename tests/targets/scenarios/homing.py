"""Setting of positions, and homing with and without success."""

from __future__ import annotations

import math
from typing import Final

from servo_msgs_py.axis_config_transfer import read_block, send_block, take_blocks
from servo_msgs_py.catalogue import Catalogue

from targets.rig import Rig
from targets.scenarios.parts import POSITION, SPEED, features, ready, spin
from targets.scenarios.tuning import scaled

_METHOD: Final = Catalogue.load().enums["home_method_t"]
_FASTER: Final = {"home.speed": 4.0, "home.turns_max": 0.05, "home.back_off": 0.5}
"""Factors of configuration members that shorten a homing."""


def _home(rig: Rig, first: str, second: str = "NONE") -> None:
    rig.set_raw("cmd.home", _METHOD[first], _METHOD[second])


def _end(rig: Rig, axis: int = 0) -> None:
    homing = rig.catalogue.enums["home_state_t"]["HOMING"]
    rig.run(0.003)
    rig.until("the end of a homing", lambda: rig.read_words(f"axis{axis + 1}.home_state") != [homing], 3.0)


def positions(rig: Rig) -> None:
    """Positions set at rest and refused in motion; limited motion before; commands that abort a homing."""
    ready(rig)
    rig.set("cmd.home_position", 1.0, -2.0)
    _home(rig, "ASSUME", "HERE")
    rig.run(0.002)
    _home(rig, "STOP_POSITIVE", "ASSUME")  # axis 1: not controlled; axis 2: position already known
    rig.run(0.002)
    rig.set_raw("param.feedback", 0, 1)  # invalidates the position
    rig.run(0.002)
    _home(rig, "NONE", "HERE")
    rig.run(0.002)
    rig.set_raw("param.feedback", 0, 0)
    rig.set_raw("param.features", features(), features("HOMING"))
    spin(rig)
    rig.set("cmd.position", 1.2, 100.0)  # beyond the permitted distance
    rig.run(0.005)
    _home(rig, "HERE")  # refused: in motion
    rig.set_raw("cmd.mode", POSITION, SPEED)
    rig.set("cmd.speed", 0.0, 200.0)
    rig.run(0.06)
    rig.set("cmd.speed", 0.0, -50.0)
    rig.run(0.03)
    rig.set("cmd.speed", 0.0)
    rig.run(0.02)
    _home(rig, "STOP_POSITIVE")
    rig.run(0.02)
    _home(rig, "NONE")
    rig.run(0.05)
    _home(rig, "STOP_NEGATIVE")
    rig.run(0.01)
    rig.set("cmd.position", 1.0, 0.0)
    rig.run(0.15)
    _home(rig, "STOP_NEGATIVE")
    rig.run(0.01)
    rig.set("cmd.enable", 0)
    rig.run(0.01)


def torque_ripple(rig: Rig) -> None:
    """Feed-forward against torque ripple: before and after homing, other harmonics, both directions, faded out, off."""
    ready(rig)
    rig.set_raw("param.features", features("TORQUE_RIPPLE"), features("TORQUE_RIPPLE", "FRICTION"))
    harmonics = {0: [(12, 1500, 7000), (84, 2500, 50000)], 1: [(1, 300, 0)]}
    for axis, waves in harmonics.items():
        block = read_block(rig, axis) | {"torque_ripple.lead": 2**31 // 20}
        for k, wave in enumerate(waves):
            members = zip(("order", "amplitude", "phase"), wave, strict=True)
            block |= {f"torque_ripple.{name}[{k}]": raw for name, raw in members}
        send_block(rig, axis, block)
    take_blocks(rig, list(harmonics))
    spin(rig)
    rig.set("cmd.home_position", 1.0, -200.0)
    _home(rig, "HERE", "HERE")
    rig.run(0.1)
    send_block(rig, 0, read_block(rig, 0) | {"torque_ripple.amplitude[0]": 900})
    take_blocks(rig, [0])
    rig.set_raw("cmd.mode", SPEED, SPEED)
    for first, second in ((20.0, -200.0), (-60.0, 0.5)):  # half faded out, and completely
        rig.set("cmd.speed", first, second)
        rig.run(0.08)
    rig.set_raw("param.features", features(), features("TORQUE_RIPPLE"))
    rig.run(0.05)


def homing(rig: Rig) -> None:
    """Homing to a stop at changing positions, without a stop, and between two stops."""
    ready(rig)
    scaled(rig, dict.fromkeys((0, 1), _FASTER))
    spin(rig)
    step = 2.0 * math.pi / 4000
    (start,) = rig.read_words("axis1.position")
    rig.obstruct_shaft(0, 10 * step, math.inf)
    rig.obstruct_shaft(1, math.inf, math.inf)
    _home(rig, "STOP_NEGATIVE", "STOP_POSITIVE")  # axis 2 has no stop
    for shift in (0, 5, -4):
        rig.until("a contact", lambda: rig.read_words("axis1.position")[0] < start and rig.get("axis1.i_q") < -0.6, 3.0)
        rig.until("the back-off", lambda: rig.get("axis1.speed") > 5.0, 3.0)
        rig.run(0.004)
        rig.obstruct_shaft(0, (rig.read_words("axis1.position")[0] - start + 10 - shift) * step, math.inf)
    _end(rig)
    _end(rig, 1)
    rig.obstruct_shaft(0, 0.005, 0.005)  # stops in both directions
    _home(rig, "STOP_NEGATIVE")
    _end(rig)


def blocked(rig: Rig) -> None:
    """A stop before the switch, and contacts that are too far apart."""
    ready(rig)
    scaled(rig, dict.fromkeys((0, 1), _FASTER))
    spin(rig)
    rig.obstruct_shaft(0, math.inf, 0.01)
    rig.obstruct_shaft(1, 0.01, math.inf)
    _home(rig, "SWITCH_POSITIVE", "STOP_NEGATIVE")
    _end(rig)
    for _ in range(3):
        rig.until("a contact", lambda: rig.get("axis2.i_q") < -0.6, 3.0)
        rig.until("the back-off", lambda: rig.get("axis2.speed") > 5.0, 3.0)
        rig.run(0.004)
        rig.obstruct_shaft(1, 0.03, math.inf)
    _end(rig, 1)
