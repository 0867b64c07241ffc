"""Diagnosis by the twin node, with rclpy."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from servo_msgs_py.runtime.qos import latched_qos
from servo_twin.calibrate_node import Calibration
from servo_twin.diagnosis.board_pair import BoardPair, Motion
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.plant import PlantConfig
from test_twin_node import DOMAIN, Rig
from twin_rig import COLUMNS

pytestmark = pytest.mark.realtime

TOPIC = "/twin/diagnosis"
PLANT = PlantConfig.load()


class DiagnosisRig(Rig):
    """`Rig` that subscribes to the diagnosis."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__(**parameters)
        self._listen(TOPIC, DiagnosticArray, latched_qos())
        self._draw = random.Random(4)
        self.board.enable_axes()

    def __enter__(self) -> DiagnosisRig:
        super().__enter__()
        return self

    def moves(self, condition: Callable[[], bool], times: int = 40) -> bool:
        """Move back and forth until a condition holds; False if it does not after `times` moves."""
        for _ in range(times):
            self.board.move([self._draw.uniform(-8.0, 8.0), self._draw.uniform(-8.0, 8.0)], 0.5)
            self.caught_up()
            if condition():
                return True
        return False

    def said(self, place: str) -> str:
        """Last message of a joint or of the bus; empty: none."""
        statuses = [s for m in self.messages[TOPIC][-1:] for s in m.status if s.name.endswith(f"diagnosis {place}")]
        return statuses[0].message if statuses else ""

    def found(self, place: str, text: str) -> Callable[[], bool]:
        """Condition: the last message contains a text."""
        return lambda: text in self.said(place)


def test_a_changed_friction_is_reported(capfd: pytest.CaptureFixture[str]) -> None:
    with DiagnosisRig() as rig:
        assert rig.moves(lambda: bool(rig.last("/twin/healthy")))
        friction = rig.board.board.plant.axes[1].friction
        rig.board.board.set_plant("axis2.friction", 2.0 * friction)
        assert rig.moves(rig.found("axis2", "friction 2."))
        assert rig.last("/twin/healthy") is False
        assert "diagnosis: axis2: friction" in capfd.readouterr().err
        assert rig.said("axis1") == rig.said("bus") == "nothing has changed"
        levels = {s.name.rpartition(" ")[2]: s.level for s in rig.messages[TOPIC][-1].status}
        assert levels == {"axis1": DiagnosticStatus.OK, "axis2": DiagnosticStatus.WARN, "bus": DiagnosticStatus.OK}
        rig.board.board.set_plant("axis2.friction", friction)
        assert rig.moves(rig.found("axis2", "nothing has changed"))
        assert rig.moves(lambda: bool(rig.last("/twin/healthy")))


def test_the_twin_adopts_a_change() -> None:
    with DiagnosisRig(adapt=True) as rig:
        assert rig.moves(lambda: bool(rig.last("/twin/healthy")))
        before = rig.node._twin.synchronisations
        rig.board.board.set_plant("axis1.inertia", 1.5 * rig.board.board.plant.axes[0].inertia)
        assert rig.moves(lambda: rig.node._plant.axes[0].inertia > 1.1e-5)
        assert rig.moves(lambda: bool(rig.last("/twin/healthy")))
        assert rig.said("axis1") == "nothing has changed"
        assert rig.node._plant.axes[0].inertia == pytest.approx(1.2e-5, rel=0.03)
        assert rig.node._twin.synchronisations == before


def test_calibrate_writes_a_threshold_file_for_the_twin(tmp_path: Path) -> None:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    out = tmp_path / "calibrated.toml"
    values = {"out": str(out), "duration": 250.0}
    try:
        node = Calibration(context=context, parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
        try:
            with BoardPair(PLANT, PLANT, seed=21, level="ideal") as pair:
                pair.enable()
                for one in Motion(pair, 21).run(260.0):
                    node._diagnose(one)
                    if node.finished:
                        break
            assert (node.finished, node.failure) == (True, "")
        finally:
            node.shutdown()
    finally:
        rclpy.shutdown(context=context)
    calibrated = Thresholds.load(out)
    assert calibrated.run_hours == pytest.approx(250.0 / 3600.0, rel=0.01)
    assert calibrated.axes[0].torque == pytest.approx(Thresholds.load(level="ideal").axes[0].torque, rel=0.1)


def test_missing_voltages_of_the_telemetry_are_reported() -> None:
    with DiagnosisRig() as rig:
        keep = [k for k, name in enumerate(COLUMNS) if not name.endswith((".u_d", ".u_q"))]
        rig._rows.clear()
        samples = rig.add_samples
        rig.add_samples = lambda columns, table: samples([columns[k] for k in keep], table[:, keep])  # type: ignore[method-assign]
        assert rig.moves(rig.found("axis1", "no diagnosis: the telemetry has no axis1.u_d, axis1.u_q"))
