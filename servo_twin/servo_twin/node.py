"""``servo_twin``: the twin as a ROS 2 node.

A thin shell: callbacks pass telemetry and commands to `TwinWorker`, whose thread simulates and publishes. Time is
board ticks; the ROS clock is used only for the stamps of messages.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_msgs_py.board_description import DEFAULT_BOARD, OtherBoardError, check_board
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import (
    diagnostic_array,
    diagnostic_status,
    joint_state,
    joint_state_from_values,
    snapshot_message,
    trace_message,
)
from servo_msgs_py.joints import Joint, joint_names
from servo_msgs_py.robot_description import joints_of
from servo_msgs_py.run_file.run_info import RunInfoError, run_info
from servo_msgs_py.runtime.node_shell import claim_name, destroyed_on_error, full_name, run
from servo_msgs_py.runtime.notify import notify
from servo_msgs_py.runtime.parameters import ParameterError, declare, spec
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from servo_msgs_py import topics
from servo_twin.board import Board, SimulationError
from servo_twin.diagnosis.monitor import DiagnosisMonitor
from servo_twin.diagnosis.report import NOTHING_CHANGED, estimate_numbers, estimate_text, finding_text, findings_text
from servo_twin.diagnosis.thresholds import Thresholds as DiagnosisThresholds
from servo_twin.level import chosen_level
from servo_twin.lockstep.board_topics import BOARD_TOPICS, BoardTopic
from servo_twin.lockstep.bursts import BurstAnswer
from servo_twin.lockstep.residual import COMPARED, HealthMonitor, Residual, Thresholds, residual
from servo_twin.lockstep.twin import Pair, Twin, TwinSettings
from servo_twin.lockstep.worker import TwinWorker
from servo_twin.plant import PlantConfig
from servo_twin.robot.command import load_on_line

if TYPE_CHECKING:
    from servo_twin.robot.robot_model import RobotModel

_DIAGNOSIS_NS: Final = 250_000_000  # interval of messages with new estimates [ns of board time]
_BACKLOG_WARNING: Final = 0.5  # [s]

PARAMETERS: Final = {
    "board_namespace": spec(
        "servo",
        "namespace of the bridge node; without a leading slash relative to the parent namespace of the twin: "
        "servo is /a/servo for a twin in /a/twin",
    ),
    "plant": spec("", "TOML file with changes of the packaged plant.toml; empty: no changes"),
    "robot": spec("", "MuJoCo model (MJCF) of what the shafts move, or an example such as arm; empty: none"),
    "seed": spec(1, "seed of the sensor noise of the twin's board", 0, 2**31 - 1),
    "position_tolerance": spec(0.05, "largest position residual of a healthy twin [rad of the joint]", 1e-4, 1e3),
    "velocity_tolerance": spec(10.0, "largest velocity residual of a healthy twin [rad/s of the joint]", 1e-3, 1e4),
    "effort_tolerance": spec(0.05, "largest effort residual of a healthy twin [N m at the joint]", 1e-5, 1e3),
    "healthy_after": spec(0.5, "time of small residuals before the twin is healthy [s]", 0.0, 60.0),
    "unhealthy_after": spec(0.1, "time of a large residual before the twin is unhealthy [s]", 0.0, 60.0),
    "report_timeout": spec(
        0.05, "time that a sample waits for the report of a command that it counts as applied [s]", 0.0, 1.0
    ),
    "variable_rate": spec(20.0, "rate of the residual/<variable> topics [Hz]", 0.1, 1000.0),
    "thresholds": spec(
        "", "threshold file of `servo_twin calibrate`; empty: packaged thresholds of two virtual boards"
    ),
    "adapt": spec(False, "adopt detected changes in the plant of the twin"),
}
"""Parameters of the node; ``config/servo_twin.yaml`` is generated from them."""


class ServoTwin(Node):
    """The node.

    Parameters
    ----------
    node_arguments : keyword arguments
        For `rclpy.node.Node`.

    Raises
    ------
    ParameterError
        If a parameter is invalid.
    """

    finished = False  # runs until it is stopped
    NAMESPACE = "twin"
    PARAMETERS = PARAMETERS

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("servo_twin", namespace=self.NAMESPACE, **node_arguments)
        with destroyed_on_error(self):
            self._set_up()

    def _set_up(self) -> None:
        self.failure = ""  # reason for the end of the node; empty: none
        self._log = Node.get_logger(self)
        claim_name(self)
        self._values = declare(self, self.PARAMETERS)
        self._board_namespace = topics.within(self.get_namespace().rpartition("/")[0], self._values["board_namespace"])
        self._catalogue = Catalogue.load()
        self._plant, self._robot, calibrated = self._files()
        self._diagnosis = DiagnosisMonitor(self._plant, calibrated)
        self._twin = Twin(
            self._new_board,
            TwinSettings(report_timeout=self._values["report_timeout"]),
            self._catalogue,
            None if self._robot is None else self._robot.attach,
        )
        self._monitor = HealthMonitor(
            Thresholds(
                position=self._values["position_tolerance"],
                velocity=self._values["velocity_tolerance"],
                effort=self._values["effort_tolerance"],
                hold=self._values["healthy_after"],
                grace=self._values["unhealthy_after"],
            )
        )
        self._lock = (
            threading.Lock()
        )  # for the members that callbacks and worker thread share: monitor, joints, last published values
        self._joints: list[Joint] = []  # from robot_description; empty until received
        self._configured = False  # the bridge has published the configuration of the board since the connection
        self._variables: dict[str, Any] = {}
        self._board_error = ""
        self._hardware_error = ""  # the board is not that of the twin
        self._fault = ""  # fault of the board
        self._parameter_error = ""
        self._samples_before = 0
        self._compared = False
        self._synchronisation = 0
        self._worst: Residual | None = None
        self._next_variables = 0
        self._diagnosed_ns = 0
        self._missing = ""  # variables of the diagnosis that the telemetry does not contain
        self._findings_text = ""  # detected changes; empty: none
        self._statuses: list[DiagnosticStatus] = []
        self._published: dict[str, object] = {}
        self._advertise()
        self._worker = TwinWorker(self._twin, self._publish, self._worker_failed)
        self._worker.start()
        self._subscribe()
        self.create_service(Trigger, topics.RESYNC, self._on_resync)
        self.create_timer(1.0, self._every_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._publish_changes()

    # ---- construction
    def _files(self) -> tuple[PlantConfig, RobotModel | None, DiagnosisThresholds]:
        """Read the files of the parameters ``plant``, ``robot`` and ``thresholds``."""
        with _file_of("plant"):
            plant = PlantConfig.load(self._values["plant"] or None)
        with _file_of("robot"):
            name = self._values.get("robot")
            robot = load_on_line(name, plant) if name else None
            plant = plant if robot is None else robot.plant(plant)
        with _file_of("thresholds"):
            return plant, robot, DiagnosisThresholds.load(self._values.get("thresholds") or None, chosen_level())

    def _new_board(self) -> Board:
        return (self._robot.board if self._robot else Board)(self._plant, seed=self._values["seed"])

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
        for topic in BOARD_TOPICS:
            callback = partial(self._on_board, topic)
            qos = latched_qos() if topic.latched else deep
            self.create_subscription(topic.message, f"{board}/{topic.name}", callback, qos)
        self.create_subscription(DiagnosticStatus, f"{board}/{topics.LINK}", self._on_link, latched_qos())
        self.create_subscription(String, f"{board}/{topics.RUN_INFO}", self._on_run_info, latched_qos())
        description = f"{board}/{topics.ROBOT_DESCRIPTION}"
        self.create_subscription(String, description, self._on_description, latched_qos())

    # ---- input
    def _on_board(self, topic: BoardTopic, message: Any) -> None:
        if topic.name == topics.TUNING:
            with self._lock:
                self._configured = True
            self._publish_changes()
        problem = ""
        try:
            topic.take(self._worker, message, self._catalogue)
        except ValueError as error:
            problem = f"{self._board_namespace}/{topic.name}: {error}"
            if topic.latched:
                self._log.warning(problem)
            else:
                self._log.warning(problem, throttle_duration_sec=10.0)
        if topic.name == topics.PARAMETERS:
            with self._lock:
                self._parameter_error = problem

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
        self._publish_changes()

    def _on_run_info(self, message: String) -> None:
        problem = ""
        try:
            board = run_info(message.data).board
            if board:
                check_board(board.get("hardware", DEFAULT_BOARD), self._catalogue.board)
        except (OtherBoardError, RunInfoError) as error:
            problem = f"{self._board_namespace}: {error}"
        with self._lock:
            if problem != self._hardware_error:
                self._hardware_error = problem
                if problem:
                    self._log.warning(f"no comparison: {problem}")
        self._publish_changes()

    def _on_link(self, message: DiagnosticStatus) -> None:
        with self._lock:
            lost = message.level != DiagnosticStatus.OK
            self._board_error = "the board is not connected" if lost else ""
            if lost:
                self._configured = False
                self._monitor.interrupt(self._board_error)
        self._publish_changes()

    def _on_resync(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._worker.resync("resynchronisation requested")
        response.success = True
        response.message = "the twin synchronises again when the shafts are at rest"
        return response

    # ---- output of the worker thread
    def _publish(self, pairs: list[Pair]) -> None:
        if self._twin.synchronisations != self._synchronisation:
            self._synchronisation = self._twin.synchronisations
            with self._lock:
                self._diagnosis.interrupt()
            text = f"following {self._board_namespace}, synchronisation {self._synchronisation}"
            self._log.info(text, throttle_duration_sec=1.0)
            notify(text, ready=True)
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
                self._monitor.interrupt(self._board_error or (f"{fault}; {status}" if fault else status))
        for answer in self._twin.burst_answers():
            self._publish_burst(answer)
        self._publish_changes()

    def _diagnose(self, pair: Pair) -> None:
        with self._lock:
            if self._unknown():
                return
            changed = self._diagnosis.update(pair)
            if not (changed or self._diagnosis.missing != self._missing):
                return
            self._missing = self._diagnosis.missing
            findings = self._diagnosis.findings()
            self._findings_text = findings_text(findings, self._names(), pair.tick, pair.stamp_ns) if findings else ""
            self._statuses = self._diagnosis_statuses(pair)
            if not 0 <= pair.stamp_ns - self._diagnosed_ns < _DIAGNOSIS_NS:
                self._diagnosed_ns = pair.stamp_ns
                self._publish_diagnosis()
            plant = self._diagnosis.adapted(pair.tick) if self._values["adapt"] else None
            if plant is None:
                return
            self._log.info(f"the twin adopts: {self._findings_text}")
            self._plant = plant
            self._diagnosis.set_plant(plant)
            self._findings_text = ""
        self._twin.take_plant(plant)

    def _names(self) -> list[str]:
        return joint_names(self._joints) or [axis_name(axis) for axis in range(AXES)]

    def _diagnosis_statuses(self, pair: Pair) -> list[DiagnosticStatus]:
        """Status per joint and of the bus: detected change and estimates."""
        findings = {one.axis: one.finding for one in self._diagnosis.findings()}
        estimates = self._diagnosis.estimates()
        statuses = []
        for axis, name in [*enumerate(self._names()), (None, "bus")]:
            finding = findings.get(axis)
            text = self._no_finding_text() if finding is None else finding_text(finding, pair.tick, pair.stamp_ns)
            mine: dict[str, object] = {}
            if finding is not None:
                mine = {"kind": finding.kind.value, "changes": " ".join(finding.changes)}
            for (place, _), one in estimates.items():
                if place == axis:
                    mine[one.name] = estimate_text(one)
                    mine |= {f"{one.name}.{part}": f"{number:.6g}" for part, number in estimate_numbers(one).items()}
            level = DiagnosticStatus.OK if finding is None else DiagnosticStatus.WARN
            statuses.append(self._status(f"diagnosis {name}", level, text, mine))
        return statuses

    def _no_finding_text(self) -> str:
        missing = self._diagnosis.missing
        return f"no diagnosis: the telemetry has no {missing}" if missing else NOTHING_CHANGED

    def _deviation(self) -> str:
        """Finding of the diagnosis, or deviation of a running mean; empty: none."""
        mean = self._diagnosis.signals.deviation
        return self._findings_text or ("" if mean is None else f"{self._names()[mean[0]]}: {mean[1]}")

    def _compare(self, pair: Pair) -> Residual | None:
        with self._lock:
            self._fault = pair.fault
            unknown = self._unknown()
            if pair.fault or pair.difference:
                self._monitor.interrupt(self._board_error or pair.fault or f"synchronising: {pair.difference}")
            elif unknown:
                self._monitor.interrupt(self._board_error or unknown)
            if pair.difference or unknown:
                return None
            result = residual(pair.tick, pair.real, pair.twin, self._twin.torque_constants, self._joints)
            if not (self._board_error or pair.fault):
                self._monitor.update(result, pair.stopping, self._deviation())
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
        """Publish the recording of the twin and its residual; warn if they are incomplete."""
        for publisher, trace in ((self._recording, answer.twin), (self._residual_recording, answer.residual)):
            if trace is not None:
                publisher.publish(trace_message(trace, answer.label))
        if answer.twin is None:
            self._log.warning(f"no recording of the twin for this burst: {answer.note}")
        elif answer.note:
            self._log.warning(f"the recording of the twin is incomplete: {answer.note}")
        else:
            self._log.info(f"recording of the twin: {len(answer.twin)} points")

    def _worker_failed(self, error: Exception) -> None:
        self.failure = f"the simulation failed: {error!r}"

    # ---- periodic output, and output on change
    def _publish_changes(self) -> None:
        """Publish state and health if they have changed."""
        with self._lock:
            labels = self._twin.labels()
            if self._twin.status or not labels:
                text = f"SYNCHRONISING {self._twin.status}"
            elif unknown := self._unknown():
                text = f"SYNCHRONISING {unknown}"
            else:
                names = joint_names(self._joints)
                text = " ".join(f"{joint}={label}" for joint, label in zip(names, labels, strict=True))
            self._publish_new_findings()
            healthy, fault = self._monitor.healthy, self._fault
            if self._published.get(topics.STATE) != text:
                self._published[topics.STATE] = text
                self._state.publish(String(data=text))
            if self._published.get(topics.HEALTHY) != healthy:
                before, self._published[topics.HEALTHY] = self._published.get(topics.HEALTHY), healthy
                self._healthy.publish(Bool(data=healthy))
                if healthy:
                    self._log.info("healthy: twin and board agree")
                elif before is not None and not fault:
                    self._log.warning(f"not healthy: {self._reason()}")
            if self._published.get("fault", "") != fault:
                self._published["fault"] = fault  # a residual may precede the fault
                if fault:
                    self._log.warning(f"not healthy: {self._reason()}")

    def _publish_new_findings(self) -> None:
        """Publish and log the diagnosis if the findings have changed."""
        found = tuple((one.axis, one.finding.kind, one.finding.changes) for one in self._diagnosis.findings())
        if self._published.get(topics.DIAGNOSIS) == found:
            return
        if found:
            self._log.warning(f"diagnosis: {self._findings_text}")
        elif self._published.get(topics.DIAGNOSIS):
            self._log.info(f"diagnosis: {NOTHING_CHANGED}")
        self._published[topics.DIAGNOSIS] = found
        self._publish_diagnosis()

    def _publish_diagnosis(self) -> None:
        now = self.get_clock().now().nanoseconds
        self._diagnosed.publish(diagnostic_array(now, self._statuses))

    def _every_second(self) -> None:
        figures = self._worker.figures()
        with self._lock:
            # Samples are counted on arrival, and may have been compared in a later period.
            if figures.samples == self._samples_before and not self._compared:
                self._monitor.interrupt(self._board_error or f"no telemetry from {self._board_namespace}")
            self._samples_before, self._compared = figures.samples, False
            worst, self._worst = self._worst, None
            healthy, reason = self._monitor.healthy, self._reason()
            self._publish_diagnosis()
        self._publish_changes()
        slow = figures.backlog > _BACKLOG_WARNING
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
                f"{figures.backlog:.1f} s behind the board" if slow else "in real time",
                {
                    "backlog [s]": f"{figures.backlog:.3f}",
                    "load": f"{figures.load:.2f}",
                    "samples": figures.samples,
                    "overruns": figures.overruns,
                },
            ),
        ]
        self._diagnostics.publish(diagnostic_array(self.get_clock().now().nanoseconds, statuses))

    def _unknown(self) -> str:
        """Reason why twin and board are not compared: another board, or missing data of the bridge; empty: none."""
        if self._hardware_error:
            return self._hardware_error
        missing = {"joints": topics.ROBOT_DESCRIPTION} if not self._joints else {}
        if not self._configured:
            missing["configuration"] = topics.TUNING
        return "; ".join(
            f"{what} unknown: no message on {self._board_namespace}/{name}" for what, name in missing.items()
        )

    def _reason(self) -> str:
        """Reason why the twin is not healthy, with a possible cause."""
        note = self._parameter_note() if self._monitor.differs else self._parameter_error
        return "; ".join(text for text in (self._monitor.reason, note) if text)

    def _parameter_note(self) -> str:
        """Reason why the parameters of the twin may differ from those of the board; empty: they do not."""
        if self._parameter_error or self._twin.parameters_known:
            return self._parameter_error
        return f"no message on {self._board_namespace}/{topics.PARAMETERS}: the twin has the default parameters"

    def _status(self, part: str, level: bytes, message: str, values: dict[str, object]) -> DiagnosticStatus:
        return diagnostic_status(f"{full_name(self)}: {part}", level, message, self._board_namespace, values)

    # ---- end
    def shutdown(self) -> None:
        """Stop the worker thread and destroy the node."""
        self._worker.stop()
        Node.destroy_node(self)


@contextmanager
def _file_of(parameter: str) -> Iterator[None]:
    """Context of the reading of a file: a `ParameterError` has the name of the parameter and what is wrong."""
    try:
        yield
    except (SimulationError, ValueError) as error:
        raise ParameterError(f"parameter {parameter}: {error}") from None
    except OSError as error:
        raise ParameterError(f"parameter {parameter}: {error.filename}: {error.strerror}; correct the path") from None


def _larger(first: Residual, second: Residual) -> Residual:
    """Residual with the larger magnitude per variable."""
    values = {name: max(first.values[name], second.values[name], key=abs) for name in COMPARED}
    return Residual(second.tick, second.joints, values, second.position, second.velocity, second.effort)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; returns the exit status."""
    purpose = "Digital twin: the firmware on a plant model, with the commands of the board, compared sample by sample."
    return run("servo_twin", purpose, PARAMETERS, lambda _: ServoTwin(), args)


if __name__ == "__main__":
    sys.exit(main())
