"""``servo_twin calibrate``: follows a healthy board and writes down what a healthy pair shows."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rclpy.node import Node
from servo_msgs_py.runtime.node_shell import ParameterError, Spec, run

from servo_twin.diagnosis.learning import FALSE_ALARM_HOURS, Learner
from servo_twin.diagnosis.thresholds import ThresholdsError
from servo_twin.lockstep.twin import Pair
from servo_twin.node import PARAMETERS as TWIN_PARAMETERS
from servo_twin.node import ServoTwin

PARAMETERS: Final = {
    **{name: spec for name, spec in TWIN_PARAMETERS.items() if name not in ("thresholds", "adapt")},
    "duration": Spec(300.0, "time of the board that is learned from [s]; move both axes as in use", 60.0, 1e5),
    "false_alarm_hours": Spec(FALSE_ALARM_HOURS, "mean time between false alarms [h of motion]", 1.0, 1e5),
    "out": Spec("thresholds.toml", "file to write; the parameter thresholds of servo_twin takes it"),
}
"""Every parameter of the program."""


class Calibration(ServoTwin):
    """A twin that learns instead of judging, in a namespace of its own; `finished` when the file has been written."""

    NAMESPACE = "twin_calibration"
    PARAMETERS = PARAMETERS

    def _set_up(self) -> None:
        super()._set_up()
        self._learner = Learner(self._plant)
        self._first: int | None = None
        self._progress = 0
        out = Path(self._values["out"]).expanduser()
        if not out.absolute().parent.is_dir():
            raise ParameterError(f"parameter out: there is no folder {out.absolute().parent}")

    def _diagnose(self, pair: Pair) -> None:
        if self.finished or self.failure:
            return
        self._learner.add(pair)
        if self._first is None:
            self._first = pair.stamp_ns
        part = (pair.stamp_ns - self._first) * 1e-9 / self._values["duration"]
        if int(10.0 * part) > self._progress:
            self._progress = int(10.0 * part)
            Node.get_logger(self).info(f"learned from {10 * self._progress} % of the time")
        if part >= 1.0:
            self._finish()

    def _finish(self) -> None:
        try:
            learned = self._learner.thresholds(self._values["false_alarm_hours"])
        except ThresholdsError as error:
            self.failure = str(error)
            return
        path = Path(self._values["out"]).expanduser()
        path.write_text(learned.text(), encoding="utf-8")
        Node.get_logger(self).info(
            f"{path}: a change is one from a log likelihood ratio of {learned.detect:.1f}, which a healthy board "
            f"reaches once in {learned.false_alarm_hours:g} h of motion"
        )
        self.finished = True


def main(args: Sequence[str] | None = None) -> int:
    """Run until enough is learned, Ctrl-C or SIGTERM; returns the exit status."""
    purpose = "Learns from a healthy board in motion above which difference the twin reports a change."

    def make(_: Any) -> Calibration:
        return Calibration()

    return run("servo_twin calibrate", purpose, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
