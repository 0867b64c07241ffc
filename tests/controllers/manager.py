"""controller_manager: cycle, activation of controllers and hardware."""

from __future__ import annotations

from collections.abc import Sequence

from controllers.controllers import Controller
from controllers.hardware import CommandMessage, TopicHardware


class ControllerManager:
    """Calls hardware and controllers once per cycle.

    Parameters
    ----------
    hardware : TopicHardware
        The hardware.
    controllers : sequence of Controller
        Loaded controllers, inactive.
    rate : float
        Parameter ``update_rate`` [Hz].
    """

    def __init__(self, hardware: TopicHardware, controllers: Sequence[Controller], rate: float) -> None:
        self.hardware = hardware
        self.rate = rate
        self._controllers = list(controllers)

    def cycle(self, time: float) -> CommandMessage | None:
        """Read states, update the active controllers, and return the message, if any.

        Parameters
        ----------
        time : float
            Time of the cycle, steady clock [s].
        """
        self.hardware.read()
        for controller in self._controllers:
            if controller.active:
                controller.update(time)
        return self.hardware.write()

    def switch(self, *, start: Controller | None = None, stop: Controller | None = None) -> None:
        """Deactivate and activate controllers between two cycles."""
        if stop is not None and stop.active:
            stop.deactivate()
        if start is not None and not start.active:
            start.activate(self.hardware)

    def set_hardware_active(self, active: bool) -> None:
        """Change the state of the hardware; controllers and commands keep theirs."""
        self.hardware.active = active
