"""``servo_twin``: the twin as a ROS 2 node.

A thin shell: callbacks hand telemetry and commands to `TwinWorker`, whose thread simulates and publishes. Everything
goes by the board's ticks; the only clock here is the one that stamps messages.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import (
    applied_from_message,
    diagnostic_array,
    diagnostic_status,
    joint_state,
    joint_state_from_values,
    parameters_from_message,
    snapshot_message,
    snapshot_table,
)
from servo_msgs_py.joints import Joint, joint_names
from servo_msgs_py.recorder_setup import setup_from_message
from servo_msgs_py.robot_description import joints_of
from servo_msgs_py.runtime.node_shell import (
    ParameterError,
    Spec,
    claim_name,
    declare,
    destroyed_on_error,
    full_name,
    run,
)
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.tuning.errors import ConfigError
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from servo_msgs_py import topics
from servo_twin.board import Board
from servo_twin.diagnosis.monitor import SUPPLY, DiagnosisMonitor
from servo_twin.diagnosis.report import NOTHING_CHANGED, estimate_numbers, estimate_text, finding_text, located_text
from servo_twin.diagnosis.thresholds import Thresholds as Learned
from servo_twin.diagnosis.thresholds import ThresholdsError
from servo_twin.level import chosen_level
from servo_twin.lockstep.blocks import blocks_of_file
from servo_twin.lockstep.bursts import BurstAnswer
from servo_twin.lockstep.residual import COMPARED, HealthMonitor, Residual, Thresholds, residual
from servo_twin.lockstep.twin import Pair, Twin, TwinSettings
from servo_twin.lockstep.worker import TwinWorker
from servo_twin.plant import PlantConfig, PlantError

_DIAGNOSIS_NS: Final = 250_000_000  # between two messages of new estimates, for their curves [ns]
_SLOW: Final = 0.5  # backlog that is worth a warning [s]

PARAMETERS: Final = {
    "board_namespace": Spec(
        "servo",
        "namespace of the node that is followed; without a leading slash it lies beside the twin's: "
        "servo is /a/servo for a twin in /a/twin",
    ),
    "plant": Spec("", "TOML file with what differs from the packaged plant.toml; empty: nothing"),
    "seed": Spec(1, "seed of the sensor noise of the twin's board", 0, 2**31 - 1),
    "position_tolerance": Spec(0.05, "largest position residual of a healthy twin [rad of the joint]", 1e-4, 1e3),
    "velocity_tolerance": Spec(10.0, "largest velocity residual of a healthy twin [rad/s of the joint]", 1e-3, 1e4),
    "effort_tolerance": Spec(0.05, "largest effort residual of a healthy twin [N m at the joint]", 1e-5, 1e3),
    "healthy_after": Spec(0.5, "how long the residual has to be small first [s]", 0.0, 60.0),
    "unhealthy_after": Spec(0.1, "how long the residual may be large [s]", 0.0, 60.0),
    "report_timeout": Spec(
        0.05, "how much newer telemetry may be before a late report of a command counts as lost [s]", 0.0, 1.0
    ),
    "variable_rate": Spec(20.0, "rate of the residual/<variable> topics [Hz]", 0.1, 1000.0),
    "thresholds": Spec(
        "", "file of `servo_twin calibrate`: what a healthy pair shows; empty: what two virtual boards show"
    ),
    "adapt": Spec(False, "take over what the diagnosis finds to have changed, and follow on"),
}
"""Every parameter of the node. ``config/servo_twin.yaml`` lists the same defaults."""


class ServoTwin(Node):
    """The node.

    Parameters
    ----------
    node_arguments : keyword arguments
        For `rclpy.node.Node`.

    Raises
    ------
    ParameterError
        If a parameter does not make sense.
    """

    finished = False  # goes on until it is told to end
    NAMESPACE = "twin"
    PARAMETERS = PARAMETERS

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("servo_twin", namespace=self.NAMESPACE, **node_arguments)
        with destroyed_on_error(self):
            self._set_up()

    def _set_up(self) -> None:
        self.failure = ""  # why it cannot go on; empty while it can
        self._log = Node.get_logger(self)
        claim_name(self)
        self._values = declare(self, self.PARAMETERS)
        self._board_namespace = topics.within(self.get_namespace().rpartition("/")[0], self._values["board_namespace"])
        self._catalogue = Catalogue.load()
        self._plant, learned = self._files()
        self._diagnosis = DiagnosisMonitor(self._plant, learned)
        self._adaptations = 0
        self._twin = Twin(self._new_board, TwinSettings(report_timeout=self._values["report_timeout"]), self._catalogue)
        self._monitor = HealthMonitor(
            Thresholds(
                position=self._values["position_tolerance"],
                velocity=self._values["velocity_tolerance"],
                effort=self._values["effort_tolerance"],
                hold=self._values["healthy_after"],
                grace=self._values["unhealthy_after"],
            )
        )
        self._lock = threading.Lock()  # the monitor, the joints and what was said last are used by both threads
        self._joints: list[Joint] = []  # as the board's node describes them; none before
        self._variables: dict[str, Any] = {}
        self._board_trouble = ""
        self._fault = ""  # of the board
        self._parameter_trouble = ""
        self._samples_before = 0
        self._compared = False
        self._synchronisation = 0
        self._worst: Residual | None = None
        self._next_variables = 0
        self._diagnosed_ns = 0
        self._missing = ""  # of the telemetry, for the diagnosis
        self._located = ""  # what has changed; empty: nothing
        self._statuses: list[DiagnosticStatus] = []
        self._said: dict[str, object] = {}
        self._advertise()
        self._worker = TwinWorker(self._twin, self._publish, self._worker_failed)
        self._worker.start()
        self._subscribe()
        self.create_service(Trigger, topics.RESYNC, self._on_resync)
        self.create_timer(1.0, self._every_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._say()

    # ---- construction
    def _files(self) -> tuple[PlantConfig, Learned]:
        """Plant and thresholds that the parameters name."""
        try:
            plant = PlantConfig.load(self._values["plant"] or None)
        except (PlantError, OSError) as error:
            raise ParameterError(f"parameter plant: {error}") from None
        try:
            return plant, Learned.load(self._values.get("thresholds") or None, chosen_level())
        except (ThresholdsError, OSError) as error:
            raise ParameterError(f"parameter thresholds: {error}") from None

    def _new_board(self) -> Board:
        return Board(self._plant, seed=self._values["seed"])

    def _advertise(self) -> None:
        deep, latched = telemetry_qos(), latched_qos()
        self._joint_states = self.create_publisher(JointState, topics.JOINT_STATES, deep)
        self._snapshot = self.create_publisher(Float64MultiArray, topics.SNAPSHOT, deep)
        self._residual = self.create_publisher(JointState, topics.RESIDUAL, deep)
        self._recording = self.create_publisher(Float64MultiArray, topics.RECORDING, latched)
        self._residual_recording = self.create_publisher(Float64MultiArray, topics.RESIDUAL_RECORDING, latched)
        self._state = self.create_publisher(String, topics.STATE, latched)
        self._healthy = self.create_publisher(Bool, topics.HEALTHY, latched)
        self._diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, 10)
        self._diagnosed = self.create_publisher(DiagnosticArray, topics.DIAGNOSIS, latched)

    def _subscribe(self) -> None:
        board, deep = self._board_namespace, telemetry_qos(200)
        applied = f"{board}/{topics.COMMANDS_APPLIED}"
        self.create_subscription(Float64MultiArray, f"{board}/{topics.SNAPSHOT}", self._on_snapshot, deep)
        self.create_subscription(Float64MultiArray, applied, self._on_applied, deep)
        parameters = f"{board}/{topics.PARAMETERS}"
        self.create_subscription(Float64MultiArray, parameters, self._on_parameters, latched_qos())
        windings = f"{board}/{topics.WINDING_TEMPERATURES}"
        self.create_subscription(Float64MultiArray, windings, self._on_windings, latched_qos())
        self.create_subscription(String, f"{board}/{topics.TUNING}", self._on_tuning, latched_qos())
        self.create_subscription(String, f"{board}/{topics.STATE}", self._on_board_state, latched_qos())
        description = f"{board}/{topics.ROBOT_DESCRIPTION}"
        self.create_subscription(String, description, self._on_description, latched_qos())

        recorder, recording = f"{board}/{topics.RECORDER}", f"{board}/{topics.RECORDING}"
        self.create_subscription(Float64MultiArray, recorder, self._on_recorder, latched_qos())
        self.create_subscription(Float64MultiArray, recording, self._on_recording, latched_qos())

    # ---- what comes in
    def _on_snapshot(self, message: Float64MultiArray) -> None:
        try:
            columns, table = snapshot_table(message)
        except ValueError as error:
            self._log.warning(f"{self._board_namespace}/{topics.SNAPSHOT}: {error}", throttle_duration_sec=10.0)
            return
        self._worker.samples(columns, table)

    def _on_applied(self, message: Float64MultiArray) -> None:
        try:
            command = applied_from_message(message)
        except ValueError as error:
            self._log.warning(str(error), throttle_duration_sec=10.0)
            return
        self._worker.command(command)

    def _on_parameters(self, message: Float64MultiArray) -> None:
        try:
            values = parameters_from_message(message, self._catalogue)
        except ValueError as error:
            with self._lock:
                self._parameter_trouble = f"the twin cannot take the parameters of the board: {error}"
            self._log.warning(self._parameter_trouble)
            return
        with self._lock:
            self._parameter_trouble = ""
        self._worker.parameters(values)

    def _on_windings(self, message: Float64MultiArray) -> None:
        span = self._catalogue[f"{axis_name(0)}.winding_temperature"]
        values = [float(value) for value in message.data]
        if len(values) != AXES or not all(span.minimum <= value <= span.maximum for value in values):
            self._log.warning(
                f"{self._board_namespace}/{topics.WINDING_TEMPERATURES}: {values} are no {AXES} temperatures"
            )
            return
        self._worker.windings(values)

    def _on_recorder(self, message: Float64MultiArray) -> None:
        try:
            setup = setup_from_message(message)
        except ValueError as error:
            self._log.warning(f"{self._board_namespace}/{topics.RECORDER}: {error}")
            return
        self._worker.recorder(setup)

    def _on_recording(self, message: Float64MultiArray) -> None:
        try:
            columns, table = snapshot_table(message)
            if "tick" not in columns or not len(table) or not np.isfinite(table[:, columns.index("tick")]).all():
                raise ValueError("a burst without ticks")
        except ValueError as error:
            self._log.warning(f"{self._board_namespace}/{topics.RECORDING}: {error}")
            return
        self._worker.burst(message.layout.dim[0].label, columns, table)

    def _on_tuning(self, message: String) -> None:
        if not message.data:
            return  # the bridge cannot read it
        try:
            blocks = blocks_of_file(message.data, self._catalogue)
        except ConfigError as error:
            self._log.warning(f"the twin cannot take the configuration of the board: {error}")
            return
        self._worker.blocks(blocks)

    def _on_description(self, message: String) -> None:
        try:
            joints = joints_of(message.data)
        except ValueError as error:
            self._log.warning(f"{self._board_namespace}/{topics.ROBOT_DESCRIPTION}: {error}")
            return
        with self._lock:
            if joint_names(joints) != joint_names(self._joints):
                for publisher in self._variables.values():
                    self.destroy_publisher(publisher)
                names, deep = joint_names(joints), telemetry_qos()
                self._variables = {
                    name: self.create_publisher(Float64, topics.residual_topic(name, names), deep) for name in COMPARED
                }
            self._joints = joints
        self._say()

    def _on_board_state(self, message: String) -> None:
        with self._lock:
            lost = message.data.startswith("DISCONNECTED")
            self._board_trouble = "the board is not connected" if lost else ""
            if lost:
                self._monitor.interrupt(self._board_trouble)
        self._say()

    def _on_resync(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._worker.resync("asked to begin anew")
        response.success = True
        response.message = "the twin begins anew as soon as the shafts are at rest"
        return response

    # ---- what goes out, in the worker's thread
    def _publish(self, pairs: list[Pair]) -> None:
        if self._twin.synchronisations != self._synchronisation:
            self._synchronisation = self._twin.synchronisations
            with self._lock:
                self._diagnosis.interrupt()
            text = f"following {self._board_namespace}, synchronisation {self._synchronisation}"
            self._log.info(text, throttle_duration_sec=1.0)
        if pairs:
            with self._lock:
                self._compared = True
            self._publish_table(pairs)
            for pair in pairs:
                self._diagnose(pair)
                self._publish_joints(pair, self._compare(pair))
        elif self._twin.status:
            with self._lock:
                fault = self._fault = self._twin.fault
                status = f"synchronising: {self._twin.status}"
                self._monitor.interrupt(self._board_trouble or (f"{fault}; {status}" if fault else status))
        for answer in self._twin.burst_answers():
            self._publish_burst(answer)
        self._say()

    def _diagnose(self, pair: Pair) -> None:
        with self._lock:
            changed = self._diagnosis.update(pair)
            if not (changed or self._diagnosis.missing != self._missing):
                return
            self._missing = self._diagnosis.missing
            findings = self._diagnosis.findings()
            self._located = located_text(findings, self._names(), pair.tick, pair.stamp_ns) if findings else ""
            self._statuses = self._diagnosis_statuses(pair)
            if not 0 <= pair.stamp_ns - self._diagnosed_ns < _DIAGNOSIS_NS:
                self._diagnosed_ns = pair.stamp_ns
                self._publish_diagnosis()
            plant = self._diagnosis.adapted(pair.tick) if self._values["adapt"] else None
            if plant is None:
                return
            self._log.info(f"the twin takes over: {self._located}")
            self._plant = plant
            self._adaptations += 1
            self._diagnosis.set_plant(plant)
            self._located = ""
        self._twin.take_plant(plant)

    def _names(self) -> list[str]:
        return joint_names(self._joints) or [axis_name(axis) for axis in range(AXES)]

    def _diagnosis_statuses(self, pair: Pair) -> list[DiagnosticStatus]:
        """One status per joint and one of the bus: what has changed, and the estimates."""
        findings = {one.axis: one.finding for one in self._diagnosis.findings()}
        estimates = self._diagnosis.estimates()
        statuses = []
        for axis, name in [*enumerate(self._names()), (None, "bus")]:
            finding = findings.get(axis)
            text = self._nothing() if finding is None else finding_text(finding, pair.tick, pair.stamp_ns)
            prefix = "" if axis is None else f"{axis_name(axis)}."
            mine: dict[str, object] = {}
            for key, one in estimates.items():
                if (key == SUPPLY) == (axis is None) and key.startswith(prefix):
                    mine[one.name] = estimate_text(one)
                    mine |= {f"{one.name}.{part}": f"{number:.6g}" for part, number in estimate_numbers(one).items()}
            level = DiagnosticStatus.OK if finding is None else DiagnosticStatus.WARN
            statuses.append(self._status(f"diagnosis {name}", level, text, mine))
        return statuses

    def _nothing(self) -> str:
        missing = self._diagnosis.missing
        return f"no diagnosis: the telemetry has no {missing}" if missing else NOTHING_CHANGED

    def _complaint(self) -> str:
        """What the diagnosis or a running mean says against the twin; empty if nothing does."""
        wrong = self._diagnosis.watch.complaint
        return self._located or ("" if wrong is None else f"{self._names()[wrong[0]]}: {wrong[1]}")

    def _compare(self, pair: Pair) -> Residual | None:
        with self._lock:
            self._fault = pair.fault
            if pair.fault or pair.difference:
                self._monitor.interrupt(self._board_trouble or pair.fault or f"synchronising: {pair.difference}")
            elif not self._joints:
                self._monitor.interrupt(self._board_trouble or self._undescribed())
            if pair.difference or not self._joints:
                return None
            result = residual(pair.tick, pair.real, pair.twin, self._twin.torque_constants, self._joints)
            if not (self._board_trouble or pair.fault):
                self._monitor.update(result, pair.stopping, self._complaint())
            self._worst = result if self._worst is None else _larger(self._worst, result)
            return result

    def _publish_table(self, pairs: Sequence[Pair]) -> None:
        names = list(pairs[-1].twin)
        rows = [
            [*pair.twin.values(), *divmod(pair.stamp_ns, 1_000_000_000)] for pair in pairs if list(pair.twin) == names
        ]
        self._snapshot.publish(snapshot_message([*names, *topics.STAMP_COLUMNS], rows))

    def _publish_joints(self, pair: Pair, difference: Residual | None) -> None:
        stamp, joints = pair.stamp_ns, self._joints
        if joints:
            message = joint_state_from_values(joints, stamp, pair.twin, self._twin.torque_constants)
            self._joint_states.publish(message)
        if difference is None:
            return
        self._residual.publish(
            joint_state(difference.joints, stamp, difference.position, difference.velocity, difference.effort)
        )
        if stamp >= self._next_variables or self._next_variables - stamp > 2_000_000_000:
            self._next_variables = stamp + round(1e9 / self._values["variable_rate"])
            with self._lock:
                for name, publisher in self._variables.items():
                    publisher.publish(Float64(data=difference.values[name]))

    def _publish_burst(self, answer: BurstAnswer) -> None:
        """Publish what the twin has of a burst; say what it has not."""
        for publisher, table in ((self._recording, answer.twin), (self._residual_recording, answer.residual)):
            if len(table):
                message = snapshot_message(answer.columns, table.tolist())
                message.layout.dim[0].label = answer.label
                publisher.publish(message)
        if not len(answer.twin):
            self._log.warning(f"no burst of the twin beside that of the board: {answer.note}")
        elif answer.note:
            self._log.warning(f"the burst of the twin is not complete: {answer.note}")
        else:
            self._log.info(f"the burst of the board on the twin: {len(answer.twin)} points")

    def _worker_failed(self, error: Exception) -> None:
        self.failure = f"the simulation failed: {error!r}"

    # ---- what goes out regularly, or when it changes
    def _say(self) -> None:
        """Publish state and health where they have changed."""
        with self._lock:
            labels = self._twin.labels()
            if self._twin.status or not labels:
                text = f"SYNCHRONISING {self._twin.status}"
            elif not self._joints:
                text = f"SYNCHRONISING {self._undescribed()}"
            else:
                names = joint_names(self._joints)
                text = " ".join(f"{joint}={label}" for joint, label in zip(names, labels, strict=True))
            self._say_diagnosis()
            healthy, fault = self._monitor.healthy, self._fault
            if self._said.get(topics.STATE) != text:
                self._said[topics.STATE] = text
                self._state.publish(String(data=text))
            if self._said.get(topics.HEALTHY) != healthy:
                before, self._said[topics.HEALTHY] = self._said.get(topics.HEALTHY), healthy
                self._healthy.publish(Bool(data=healthy))
                if healthy:
                    self._log.info("healthy: twin and board agree")
                elif before is not None and not fault:
                    self._log.warning(f"not healthy: {self._reason()}")
            if self._said.get("fault", "") != fault:
                self._said["fault"] = fault  # a residual may have shown before the fault
                if fault:
                    self._log.warning(f"not healthy: {self._reason()}")

    def _say_diagnosis(self) -> None:
        """Publish the diagnosis, and log it, where another thing has changed."""
        found = tuple((one.axis, one.finding.kind, one.finding.changes) for one in self._diagnosis.findings())
        if self._said.get(topics.DIAGNOSIS) == found:
            return
        if found:
            self._log.warning(f"diagnosis: {self._located}")
        elif self._said.get(topics.DIAGNOSIS):
            self._log.info(f"diagnosis: {NOTHING_CHANGED}")
        self._said[topics.DIAGNOSIS] = found
        self._publish_diagnosis()

    def _publish_diagnosis(self) -> None:
        now = self.get_clock().now().nanoseconds
        self._diagnosed.publish(diagnostic_array(now, self._statuses))

    def _every_second(self) -> None:
        figures = self._worker.figures()
        with self._lock:
            # Samples count when they come; those that came before the last look may have been compared since.
            if figures.samples == self._samples_before and not self._compared:
                self._monitor.interrupt(self._board_trouble or f"no telemetry from {self._board_namespace}")
            self._samples_before, self._compared = figures.samples, False
            worst, self._worst = self._worst, None
            healthy, reason = self._monitor.healthy, self._reason()
            self._publish_diagnosis()
        self._say()
        slow = figures.backlog > _SLOW
        residuals = {} if worst is None else {f"largest {name}": f"{value:.4g}" for name, value in worst.values.items()}
        statuses = [
            self._status(
                "comparison",
                DiagnosticStatus.OK if healthy else DiagnosticStatus.WARN,
                "healthy" if healthy else reason,
                residuals
                | {
                    "synchronisations": self._twin.synchronisations,
                    "parameters": self._parameter_note() or "those of the board",
                },
            ),
            self._status(
                "simulation",
                DiagnosticStatus.WARN if slow else DiagnosticStatus.OK,
                f"{figures.backlog:.1f} s behind the board" if slow else "keeps up",
                {
                    "backlog [s]": f"{figures.backlog:.3f}",
                    "load": f"{figures.load:.2f}",
                    "samples": figures.samples,
                    "overruns": figures.overruns,
                },
            ),
        ]
        self._diagnostics.publish(diagnostic_array(self.get_clock().now().nanoseconds, statuses))

    def _undescribed(self) -> str:
        return f"nothing on {self._board_namespace}/{topics.ROBOT_DESCRIPTION}: the joints are not known"

    def _reason(self) -> str:
        """Why the twin is not healthy, with what may have led to it."""
        note = self._parameter_note() if self._monitor.differs else self._parameter_trouble
        return "; ".join(text for text in (self._monitor.reason, note) if text)

    def _parameter_note(self) -> str:
        """Why the twin's board does not have the parameters of the real one; empty if it has."""
        if self._parameter_trouble or self._twin.parameters_known:
            return self._parameter_trouble
        return f"nothing on {self._board_namespace}/{topics.PARAMETERS}: the twin has the parameters after reset"

    def _status(self, part: str, level: bytes, message: str, values: dict[str, object]) -> DiagnosticStatus:
        return diagnostic_status(f"{full_name(self)}: {part}", level, message, self._board_namespace, values)

    # ---- end
    def shutdown(self) -> None:
        """End the thread and the node."""
        self._worker.stop()
        Node.destroy_node(self)


def _larger(first: Residual, second: Residual) -> Residual:
    """Per variable the value that is further from zero."""
    values = {name: max(first.values[name], second.values[name], key=abs) for name in COMPARED}
    return Residual(second.tick, second.joints, values, second.position, second.velocity, second.effort)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; returns the exit status."""
    purpose = "The twin: the firmware on a model, led by what the board does, compared at the board's own instants."
    return run("servo_twin", purpose, PARAMETERS, lambda _: ServoTwin(), args)


if __name__ == "__main__":
    sys.exit(main())
