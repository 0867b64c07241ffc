"""``servo_twin calibrate``: measures the thresholds of the diagnosis with a healthy board."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rclpy.node import Node
from servo_msgs_py.output_file import write_file
from servo_msgs_py.runtime.node_shell import run
from servo_msgs_py.runtime.parameters import ParameterError, spec

from servo_twin.diagnosis.calibration import DURATION, FALSE_ALARM_HOURS, Calibrator
from servo_twin.diagnosis.thresholds import ThresholdsError
from servo_twin.lockstep.twin import Pair
from servo_twin.node import PARAMETERS as TWIN_PARAMETERS
from servo_twin.node import ServoTwin

PARAMETERS: Final = {
    **{name: spec for name, spec in TWIN_PARAMETERS.items() if name not in ("thresholds", "adapt")},
    "duration": spec(
        300.0, "board time of the calibration [s]; move both axes as in use", DURATION.minimum, DURATION.maximum
    ),
    "false_alarm_hours": spec(FALSE_ALARM_HOURS, "mean time between false alarms [h of motion]", 1.0, 1e5),
    "out": spec("thresholds.toml", "file to write, for the parameter thresholds of servo_twin"),
}
"""Parameters of the program."""


class Calibration(ServoTwin):
    """A twin that calibrates instead of diagnosing, in its own namespace; `finished` after the file is written."""

    NAMESPACE = "twin_calibration"
    PARAMETERS = PARAMETERS

    def _set_up(self) -> None:
        super()._set_up()
        self._calibrator = Calibrator(self._plant)
        self._first: int | None = None
        self._progress = 0
        out = Path(self._values["out"]).expanduser()
        if not out.absolute().parent.is_dir():
            raise ParameterError(f"parameter out: no such folder: {out.absolute().parent}")

    def _diagnose(self, pair: Pair) -> None:
        if self.finished or self.failure:
            return
        self._calibrator.add(pair)
        if self._first is None:
            self._first = pair.stamp_ns
        part = (pair.stamp_ns - self._first) * 1e-9 / self._values["duration"]
        if int(10.0 * part) > self._progress:
            self._progress = int(10.0 * part)
            Node.get_logger(self).info(f"calibration: {10 * self._progress} %")
        if part >= 1.0:
            self._finish()

    def _finish(self) -> None:
        try:
            calibrated = self._calibrator.thresholds(self._values["false_alarm_hours"])
        except ThresholdsError as error:
            self.failure = str(error)
            return
        path = Path(self._values["out"]).expanduser()
        write_file(path, calibrated.text())
        Node.get_logger(self).info(
            f"{path}: detection threshold of the log likelihood ratio {calibrated.detect:.1f}, one false alarm in "
            f"{calibrated.false_alarm_hours:g} h of motion"
        )
        self.finished = True


def main(args: Sequence[str] | None = None) -> int:
    """Run until the calibration is complete, Ctrl-C or SIGTERM; returns the exit status."""
    purpose = "Calibrates the thresholds of the diagnosis with a healthy board in motion."

    def make(_: Any) -> Calibration:
        return Calibration()

    return run("servo_twin calibrate", purpose, PARAMETERS, make, args, endless=False)


if __name__ == "__main__":
    sys.exit(main())
