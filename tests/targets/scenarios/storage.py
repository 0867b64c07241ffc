"""Data flash: saves, sets restored after a reset, refused requests."""

from __future__ import annotations

from servo_twin.fault_injection import StalledCore

from targets.rig import Rig
from targets.scenarios.parts import ready

SAVE, FACTORY = 1, 2


def _finish(rig: Rig) -> None:
    rig.until("the flash is done", lambda: rig.read_words("storage.state") == [0])


def _reset(rig: Rig) -> None:
    """Reset by the watchdog, which does not change the data flash."""
    rig.inject(StalledCore(0.2))
    rig.run(0.06)
    rig.until("watchdog", lambda: "WATCHDOG" in rig.faults(0))


def storage(rig: Rig) -> None:
    """A save, a save aborted by a parameter and a reset; a reset with the newest set; erased sets."""
    ready(rig)
    rig.set("param.speed_limit", 90.0, 80.0)
    rig.set_raw("storage.request", SAVE, 1)
    rig.run(0.05)
    _finish(rig)
    rig.set_raw("storage.request", SAVE, 2)
    rig.run(0.04)
    rig.set("param.speed_limit", 80.0, 90.0)
    _finish(rig)
    _reset(rig)  # copy B is damaged
    for token in (3, 3, 4):
        rig.set("param.i_q_limit", 0.5 * token)
        rig.set_raw("storage.request", SAVE, token)
        _finish(rig)
    rig.set_raw("storage.request", FACTORY, 4)  # refused: the token was used before
    rig.set_raw("storage.request", SAVE, 5)
    rig.set_raw("storage.request", FACTORY, 6)  # busy
    rig.set("cmd.clear_faults", 1)
    _finish(rig)
    rig.set("param.i_q_limit", 1.0)
    _reset(rig)  # the newest set
    rig.set("cmd.clear_faults", 1)
    rig.until("cleared", lambda: rig.states() == ["STOP", "STOP"])
    rig.set_raw("storage.request", SAVE, 7)
    rig.set("cmd.enable", 1)
    _finish(rig)
    rig.set_raw("storage.request", SAVE, 8)  # in motion
    rig.set("cmd.enable", 0)
    rig.until("off", lambda: rig.states() == ["STOP", "STOP"])
    rig.set_raw("storage.request", FACTORY, 9)
    _finish(rig)
