"""Axis that runs under control during a measurement, and is afterwards as before."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from servo_msgs_py.axis_config_transfer import read_block, send_configuration

from servo_measurement.access import BoardAccess, MeasurementError, refuse_faults
from servo_measurement.axis_under_test import HELD_SPEED, POLL_TIME, AxisUnderTest
from servo_measurement.prediction import OBSERVER
from servo_measurement.test_signal import end_test_signal

SETTLE: Final = 0.3  # settling time at the constant speed [s]
_TEST_TIME: Final = 5.0  # timeout for the start of mode TEST [s]
_SEARCH_TIME: Final = 8.0  # timeout for the rotor search [s]
_SETTLE_POLL_TIME: Final = 0.05  # [s]


class RunningAxis(AxisUnderTest):
    """An axis in SPIN, or in mode TEST; parameters as of `AxisUnderTest`."""

    @property
    def is_spinning(self) -> bool:
        return self.substate == "SPIN"

    @contextmanager
    def prepared(
        self,
        enable: bool,
        *,
        test_mode: bool = False,
        block: Mapping[str, int] | None = None,
        observed: bool | None = None,
    ) -> Iterator[None]:
        """The axis in SPIN and at rest, or in mode TEST; afterwards at rest, in its previous mode and state.

        An axis in mode TORQUE holds its position after its set-point has expired. It remains in mode POSITION: mode
        TORQUE would restart without current, and a load would fall. `block`: configuration for this time; `observed`:
        whether its speed is that of the observer, None: as before.
        """
        refuse_faults(self.access, self.axis)
        mode, was_spinning = self.label("mode"), self.is_spinning
        if was_spinning and test_mode:
            raise MeasurementError(
                f"{self.name} is enabled; a current loop is measured in mode TEST: disable the axis first"
            )
        if not was_spinning and not enable:
            raise MeasurementError(f"{self.name} is not enabled; enable it first, or use --enable")
        if not (abs(self.value("speed")) < HELD_SPEED and self.value("speed_ref") == 0.0):
            raise MeasurementError(f"{self.name} is in motion; stop it first")

        def rest() -> None:
            end_test_signal(self.access, self.axis)
            if self.is_spinning:
                self.hold()

        own = None if block is None else read_block(self.access, self.axis)

        def configuration_before() -> None:
            """Of an axis that remains enabled: the board would disable it at the end of the session."""
            if own is not None and was_spinning and self.is_spinning:
                send_configuration(self.access, {self.axis: own})

        def mode_before() -> None:
            if not was_spinning:
                return  # the board disables the axis and restores its mode at the end of the session
            if mode == "TORQUE" and self.is_spinning:
                self.report(
                    f"{self.name} holds its position in mode POSITION; it was in mode TORQUE, without a set-point"
                )
            else:
                self.mode(mode)
            self.access.wait(POLL_TIME)  # until the changes are active

        steps = (("shaft at rest", rest), ("gains", configuration_before), ("mode", mode_before))
        with self.session(steps):
            features = self.access.read_words("param.features")[self.axis]
            if block is not None:
                send_configuration(self.access, {self.axis: block})
            self.write_word("param.features", with_observer(self.access, features, observed))  # a block brings its own
            if not was_spinning:
                self.mode("TEST" if test_mode else "POSITION")
                self.enable("TEST" if test_mode else "SPIN", _TEST_TIME if test_mode else _SEARCH_TIME)
            yield

    def settle(self) -> None:
        """Wait for the constant speed."""
        for _ in range(math.ceil(SETTLE / _SETTLE_POLL_TIME)):
            self.wait(_SETTLE_POLL_TIME)
            self.refuse_limits()


def with_observer(access: BoardAccess, features: int, observed: bool | None) -> int:
    """Word of features with the speed observer on or off; None: as it is."""
    mask = access.catalogue.flag("features", OBSERVER).mask
    return features if observed is None else features | mask if observed else features & ~mask
