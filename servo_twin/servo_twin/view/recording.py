"""Recording for the rerun viewer: file, server for the browser, and reading a file.

Only this module and `blueprint` use rerun. It is imported at the first use, so that all other modules work without it.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.output_file import write_file
from servo_msgs_py.rerun_file import RecordingError, import_rerun
from servo_msgs_py.runtime.claim import ClaimError, claimed

from servo_twin.view import scene
from servo_twin.view.blueprint import blueprint

_APPLICATION: Final = "servo"
_SERVER_MEMORY: Final = "256MiB"  # history for a browser that connects later
_FLUSH_TIMEOUT: Final = 3.0  # [s]
_LEVELS: Final = ("DEBUG", "INFO", "WARN", "ERROR")
# The curves often coincide: with this order and decreasing widths all are visible.
_WIDTHS: Final = {scene.BOARD: 3.5, scene.SET_POINT: 2.0, scene.TWIN: 1.0}
# Radii in the path view, from bottom to top [pixel].
_RADII: Final = {scene.SET_POINT: 2.5, scene.BOARD: 0.8}
_DIAL: Final = 0.10  # radius of the dial behind the pointers [m]
_LABEL: Final = (255, 255, 255)  # text of the names of the shafts, on the grey of the viewer


class Recording:
    """An open recording.

    Parameters
    ----------
    path : Path, optional
        File to write, used alone until `close`; an existing file is replaced.
    grpc_port : int, optional
        Port of the data server on the loopback interface.

    Raises
    ------
    RecordingError
        If rerun is not installed, the file cannot be written, or another program writes it.
    """

    def __init__(self, path: Path | None = None, grpc_port: int | None = None) -> None:
        self._rr = rr = import_rerun()
        self._stream = rr.RecordingStream(_APPLICATION, batcher_config=rr.ChunkBatcherConfig(flush_tick=0.2))
        self._stream.set_log_tick_enabled(False)
        self._stream.set_log_time_enabled(False)
        self.uri = ""
        self._path = path or "the recording"
        sinks: list[Any] = []
        with contextlib.ExitStack() as claim:
            if path is not None:
                try:
                    claim.enter_context(claimed(Path(os.path.realpath(path))))
                except ClaimError as error:
                    raise RecordingError(str(error)) from None
                _check_writable(path)
                sinks.append(rr.FileSink(str(path)))
            if grpc_port is not None:
                server = rr.GrpcServerSink(bind_ip="127.0.0.1", port=grpc_port, server_memory_limit=_SERVER_MEMORY)
                self.uri = server.uri
                sinks.append(server)
            try:
                self._stream.set_sinks(*sinks, default_blueprint=blueprint())
            except RuntimeError as error:
                raise RecordingError(f"{path} cannot be written: {error}") from None
            self._claim = claim.pop_all()
        self._styles()
        self._shafts()

    # ---- static data
    def _styles(self) -> None:
        """Names and colours of curves and states."""
        rr, log = self._rr, self._static
        for axis, name in scene.axes():
            for quantity in scene.QUANTITIES:
                for source in (scene.SET_POINT, scene.BOARD, scene.TWIN):
                    style = rr.SeriesLines(
                        names=source.replace("_", "-"),
                        colors=[scene.COLOURS[source]],
                        widths=_WIDTHS[source],
                        aggregation_policy="MinMax",
                    )
                    log(scene.series_entity(axis, quantity.name, source), style)
            for field, unit in scene.RESIDUALS.items():
                style = rr.SeriesLines(
                    names=f"board - twin [{unit}]",
                    colors=[scene.COLOURS[scene.RESIDUAL]],
                    widths=1.5,
                    aggregation_policy="MinMax",
                )
                log(scene.residual_entity(axis, field), style)
            for state in (name, scene.home_state(name)):
                log(scene.state_entity(state), self._states())
        for order, (source, radius) in enumerate(_RADII.items()):
            style = rr.LineStrips2D.from_fields(
                colors=[scene.COLOURS[source]], radii=rr.Radius.ui_points(radius), draw_order=order
            )
            log(scene.path_entity(source), style)
        for name in ("link", "twin", "diagnosis", "path"):
            log(scene.state_entity(name), self._states())

    def _states(self) -> Any:
        names = list(scene.STATE_COLOURS)
        return self._rr.StateConfiguration(values=names, labels=names, colors=list(scene.STATE_COLOURS.values()))

    def _shafts(self) -> None:
        """Two dials side by side, each with a pointer of the board and a pointer of the twin."""
        rr, log = self._rr, self._static
        log("/shafts", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        angles = np.arange(12) * (np.pi / 6.0)
        rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(12)])
        marks = np.stack([0.90 * _DIAL * rays, 0.99 * _DIAL * rays], axis=1)
        hands = {scene.BOARD: (0.88, 0.010, 0.0028), scene.TWIN: (0.66, 0.004, 0.0075)}  # length, height, radius
        for axis, name in scene.axes():
            entity_root = f"/shafts/{name}"
            log(entity_root, rr.Transform3D(translation=[2.6 * _DIAL * axis, 0.0, 0.0]))
            log(
                f"{entity_root}/dial",
                rr.Cylinders3D(
                    lengths=[0.01, 0.06],
                    radii=[_DIAL, 0.016],
                    centers=[[0, 0, -0.006], [0, 0, -0.02]],
                    colors=[(58, 62, 70), (150, 152, 158)],
                    fill_mode="solid",
                ),
            )
            log(f"{entity_root}/marks", rr.LineStrips3D(marks, radii=0.0012, colors=[(200, 203, 210)]))
            label = rr.Points3D([[0, -1.18 * _DIAL, 0]], radii=0.0, labels=[name], show_labels=True, colors=[_LABEL])
            log(f"{entity_root}/name", label)
            for source, (length, height, radius) in hands.items():
                entity = scene.shaft_entity(axis, source)
                hand = rr.Arrows3D(
                    vectors=[[length * _DIAL, 0, 0]],
                    origins=[[0, 0, height]],
                    radii=radius,
                    colors=[scene.COLOURS[source]],
                )
                log(f"{entity}/hand", hand)

    def _static(self, entity: str, component: Any) -> None:
        self._stream.log(entity, component, static=True)

    # ---- data
    def scalars(self, entity: str, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Write points of a curve: times [s] and values [SI], each (points,); NaN: gap."""
        rr = self._rr
        self._stream.send_columns(entity, indexes=[self._column(times)], columns=rr.Scalars.columns(scalars=values))

    def angles(self, entity: str, times: NDArray[np.float64], angles: NDArray[np.float64]) -> None:
        """Write angles of a shaft [rad] at times [s], each (points,)."""
        # Quaternions x, y, z, w of a rotation about z; the angle is not wrapped.
        half = np.remainder(angles, 4.0 * np.pi) / 2.0
        zero = np.zeros_like(half)
        quaternions = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
        columns = self._rr.Transform3D.columns(quaternion=quaternions)
        self._stream.send_columns(entity, indexes=[self._column(times)], columns=columns)

    def strip(self, entity: str, time: float, points: NDArray[np.float64]) -> None:
        """Write a line strip of the path view at a time [s], (samples, 2); the second column points upwards."""
        self._stream.set_time(scene.TIMELINE, duration=time)
        # The vertical axis of a 2D view points downwards.
        self._stream.log(entity, self._rr.LineStrips2D.from_fields(strips=[points * (1.0, -1.0)]))

    def state(self, name: str, time: float, state: str) -> None:
        """Write a change of state at `time` [s]."""
        self._stream.set_time(scene.TIMELINE, duration=time)
        self._stream.log(scene.state_entity(name), self._rr.StateChange(state=state))

    def text(self, source: str, time: float, level: str, text: str) -> None:
        """Write a line of the log at a time [s]; `level` is DEBUG, INFO, WARN or ERROR."""
        assert level in _LEVELS
        self._stream.set_time(scene.TIMELINE, duration=time)
        self._stream.log(f"/log/{source}", self._rr.TextLog(f"{source}: {text}", level=level))

    def _column(self, times: NDArray[np.float64]) -> Any:
        return self._rr.TimeColumn(scene.TIMELINE, duration=times)

    def close(self) -> None:
        """Write pending data, close file and server.

        Raises
        ------
        RecordingError
            If not all could be written, such as on a full disk; the file is readable up to this point.
        """
        try:
            self._stream.flush(timeout_sec=_FLUSH_TIMEOUT)
        except (RuntimeError, ValueError) as error:
            raise RecordingError(f"{self._path} is not complete: {str(error).splitlines()[0]}") from None
        finally:
            self._stream.disconnect()
            self._claim.close()


def _check_writable(path: Path) -> None:
    """Check before rerun opens the file, which reports errors only in its own log.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    try:
        write_file(path, b"")
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror or error}") from None


# ---- reading
def read_scalars(path: Path, entity: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times [s] and values of a curve, sorted by time; empty if it does not exist.

    Raises
    ------
    RecordingError
        If the file cannot be read as a recording.
    """
    times, values = _read(path, entity, "Scalars:scalars")
    return times, values.astype(np.float64)


def read_texts(path: Path, entity: str, component: str = "TextLog:text") -> list[tuple[float, str]]:
    """Times [s] and texts of a log; of a state with ``StateChange:state``."""
    times, values = _read(path, entity, component)
    return list(zip(times.tolist(), map(str, values), strict=True))


def _read(path: Path, entity: str, component: str) -> tuple[NDArray[np.float64], NDArray[Any]]:
    import_rerun()
    from rerun.chunk import RrdReader

    times: list[Any] = []
    values: list[Any] = []
    try:
        chunks = RrdReader(path).stream().filter(content=entity, is_static=False, components=component)
        for chunk in chunks:
            if scene.TIMELINE not in chunk.timeline_names:
                continue
            batch = chunk.to_record_batch()
            batch = batch.filter(batch[component].is_valid())
            times.append(np.asarray(batch[scene.TIMELINE].cast("int64")) * 1e-9)
            values.append(batch[component].flatten().to_numpy(zero_copy_only=False))
    except (OSError, ValueError, RuntimeError) as error:
        raise RecordingError(
            f"{path} cannot be read as a recording: {error}; "
            "if only the end is missing, `rerun rrd optimize` may repair it"
        ) from None
    if not times:
        return np.empty(0), np.empty(0)
    time, value = np.concatenate(times), np.concatenate(values)
    order = np.argsort(time, kind="stable")
    return time[order], value[order]
