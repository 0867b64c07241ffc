"""A motion of a robot for the rerun viewer: the bodies of the MuJoCo model, and the curves of its drives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.recording_names import PLOT
from servo_msgs_py.rerun_file import import_rerun, recording_file

from servo_twin.view import scene

FRAME: Final = 0.02
"""Time between two poses of the bodies [s]."""

_APPLICATION: Final = "servo-sim robot"
_ROBOT: Final = "robot"  # root of the bodies
_FLOOR: Final = 5.0  # half of the side of a plane without end [m]

_Array = NDArray[np.float64]


class Poses:
    """Poses of the bodies of a model, taken at its steps.

    Parameters
    ----------
    model : mujoco.MjModel
        The model.
    """

    def __init__(self, model: Any) -> None:
        self._every = max(1, round(FRAME / model.opt.timestep))
        self._steps = 0
        self.times: list[float] = []  # [s]
        self.positions: list[_Array] = []  # (bodies, 3) [m]
        self.quaternions: list[_Array] = []  # (bodies, 4), scalar first

    def watch(self, time: float, data: Any) -> None:
        """Take the poses at a time [s], if it is their turn."""
        if self._steps % self._every == 0:
            self.times.append(time)
            self.positions.append(data.xpos.copy())
            self.quaternions.append(data.xquat.copy())
        self._steps += 1


def write_recording(
    path: Path, model: Any, poses: Poses, time: _Array, curves: Mapping[str, Mapping[tuple[str, str], _Array]]
) -> None:
    """Write a file for the rerun viewer.

    Parameters
    ----------
    path : Path
        File to be written.
    model : mujoco.MjModel
        Its bodies are shown.
    poses : Poses
        Their motion.
    time : ndarray, shape (N,)
        Times of the curves [s].
    curves : mapping
        Curves by quantity (with its unit), then by actuator and source, shape (N,) each; a plot per quantity.

    Raises
    ------
    RecordingError
        If rerun is not installed.
    OSError
        If the file cannot be written.
    """
    rr = import_rerun()
    with recording_file(_APPLICATION, path) as stream:
        stream.send_blueprint(_blueprint(curves))
        _log_shapes(rr, stream, model)
        index = [rr.TimeColumn(scene.TIMELINE, duration=np.array(poses.times))]
        for body in range(1, model.nbody):
            quaternions = np.array(poses.quaternions)[:, body, [1, 2, 3, 0]]  # scalar last
            columns = rr.Transform3D.columns(translation=np.array(poses.positions)[:, body], quaternion=quaternions)
            stream.send_columns(_entity(rr, model, body), indexes=index, columns=columns)
        index = [rr.TimeColumn(scene.TIMELINE, duration=time)]
        for quantity, series in curves.items():
            for (actuator, source), values in series.items():
                entity = rr.new_entity_path([*_plot(quantity), actuator, source])
                stream.log(entity, rr.SeriesLines(names=f"{actuator} {source}".replace("_", " ")), static=True)
                stream.send_columns(entity, indexes=index, columns=rr.Scalars.columns(scalars=values))


def _entity(rr: Any, model: Any, body: int) -> str:
    return str(rr.new_entity_path([_ROBOT, model.body(body).name or f"body{body}"]))


def _plot(quantity: str) -> tuple[str, str]:
    return PLOT, quantity.partition(" [")[0]


def _log_shapes(rr: Any, stream: Any, model: Any) -> None:
    """Log the geometries, each below the entity of its body."""
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        entity = f"{_entity(rr, model, body)}/geom{geom}"
        w, x, y, z = model.geom_quat[geom].tolist()
        place = rr.Transform3D(translation=model.geom_pos[geom], quaternion=rr.Quaternion(xyzw=[x, y, z, w]))
        stream.log(entity, place, static=True)
        stream.log(entity, _shape(rr, model, geom), static=True)


def _shape(rr: Any, model: Any, geom: int) -> Any:
    """Archetype of a geometry, in its own frame."""
    kinds = mujoco.mjtGeom
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    colour = (255.0 * model.geom_rgba[geom]).astype(np.uint8)
    solid = {"colors": [colour], "fill_mode": rr.components.FillMode.Solid}
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
        faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
        return rr.Mesh3D(
            vertex_positions=model.mesh_vert[vertices], triangle_indices=model.mesh_face[faces], albedo_factor=colour
        )
    if kind == kinds.mjGEOM_CAPSULE:  # of rerun: from the origin along z
        length = 2.0 * size[1]
        return rr.Capsules3D(lengths=[length], radii=[size[0]], translations=[[0.0, 0.0, -size[1]]], **solid)
    if kind == kinds.mjGEOM_CYLINDER:
        return rr.Cylinders3D(lengths=[2.0 * size[1]], radii=[size[0]], **solid)
    if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        return rr.Ellipsoids3D(half_sizes=[size if kind == kinds.mjGEOM_ELLIPSOID else [size[0]] * 3], **solid)
    if kind == kinds.mjGEOM_PLANE:
        return rr.Boxes3D(half_sizes=[[size[0] or _FLOOR, size[1] or _FLOOR, 0.0]], colors=[colour])
    return rr.Boxes3D(half_sizes=[size], **solid)


def _blueprint(names: Iterable[str]) -> Any:
    import rerun.blueprint as rrb

    plots = [rrb.TimeSeriesView(name=name, origin="/" + "/".join(_plot(name))) for name in names]
    panel = rrb.TimePanel(state="collapsed", timeline=scene.TIMELINE)
    robot = rrb.Spatial3DView(name="robot", origin=f"/{_ROBOT}")
    return rrb.Blueprint(rrb.Horizontal(robot, rrb.Vertical(*plots)), panel, auto_views=False, auto_layout=False)
