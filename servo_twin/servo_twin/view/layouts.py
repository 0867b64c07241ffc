"""Layouts of the plots of both axes for PlotJuggler and Foxglove, over the topics that a recording has."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from xml.etree import ElementTree

from servo_msgs_py import topics
from servo_twin.view import scene

_FIELDS: Final = {"position": "position", "speed": "velocity"}
"""Quantities that JointState has."""


@dataclass(frozen=True)
class Curve:
    """A curve over messages of one topic."""

    topic: str  # absolute
    field: str  # of JointState; ``data`` of Float64
    joint: int | None  # element of a JointState
    source: str  # of `scene.COLOURS`

    @property
    def colour(self) -> str:
        """As in HTML."""
        return "#{:02x}{:02x}{:02x}".format(*scene.COLOURS[self.source])


@dataclass(frozen=True)
class Plot:
    """Curves over one time axis."""

    title: str
    curves: tuple[Curve, ...]


def plots(joints: Sequence[str], board: str = "/servo", twin: str = "/twin") -> list[list[Plot]]:
    """Plots of each joint: the quantities of the viewer and the residual of the position.

    Parameters
    ----------
    joints : sequence of str
        Their names in the messages, in the order of the axes.
    board, twin : str
        Absolute namespaces of the bridge and of the twin.
    """
    return [[*_quantities(axis, joints, board, twin), _residual(axis, joints, twin)] for axis, _ in scene.axes()]


def plotjuggler(columns: Sequence[Sequence[Plot]], joints: Sequence[str]) -> str:
    """Layout for PlotJuggler, XML."""
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    tab = ElementTree.SubElement(window, "Tab", tab_name="axes", containers="1")
    side_by_side = _splitter(ElementTree.SubElement(tab, "Container"), "|", len(columns))
    for column in columns:
        below = _splitter(side_by_side, "-", len(column))
        for one in column:
            area = ElementTree.SubElement(below, "DockArea", name=one.title)
            style = {"mode": "TimeSeries", "style": "Lines", "flip_x": "false", "flip_y": "false"}
            plot = ElementTree.SubElement(area, "plot", style)
            for curve in one.curves:
                # Its parser of JointState names the joints, not their numbers.
                parts = [curve.topic, *([] if curve.joint is None else [joints[curve.joint]]), curve.field]
                ElementTree.SubElement(plot, "curve", name="/".join(parts), color=curve.colour)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def foxglove(columns: Sequence[Sequence[Plot]], joints: Sequence[str]) -> str:
    """Layout for Foxglove, JSON; the joints are numbers there."""
    panels: dict[str, Any] = {}
    names = [[f"Plot!axis{k}plot{n}" for n in range(len(column))] for k, column in enumerate(columns)]
    for joint, column, ids in zip(joints, columns, names, strict=True):
        for one, name in zip(column, ids, strict=True):
            panels[name] = {
                "foxglovePanelTitle": one.title,
                "xAxisVal": "timestamp",
                "isSynced": True,
                "showLegend": True,
                "paths": [
                    {
                        "value": f"{curve.topic}.{curve.field}" + ("" if curve.joint is None else f"[{curve.joint}]"),
                        "label": f"{joint} {curve.source.replace('_', '-')}",
                        "color": curve.colour,
                        "enabled": True,
                        # The times of the samples; a Float64 has none.
                        "timestampMethod": "receiveTime" if curve.joint is None else "headerStamp",
                    }
                    for curve in one.curves
                ],
            }
    document = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _nested([_nested(ids, "column") for ids in names], "row"),
    }
    return json.dumps(document, indent=2) + "\n"


FORMATS: Final[Mapping[str, Callable[[Sequence[Sequence[Plot]], Sequence[str]], str]]] = {
    ".xml": plotjuggler,
    ".json": foxglove,
}
"""Layouts by the suffix of their files."""


def _quantities(axis: int, joints: Sequence[str], board: str, twin: str) -> Iterator[Plot]:
    for quantity in scene.QUANTITIES:
        set_point, measured = (
            f"{board}/{topics.variable_topic(quantity.column(source, axis), joints)}"
            for source in (scene.SET_POINT, scene.BOARD)
        )
        curves = [Curve(set_point, "data", None, scene.SET_POINT)]
        if field := _FIELDS.get(quantity.name):
            for namespace, source in ((board, scene.BOARD), (twin, scene.TWIN)):
                curves.append(Curve(f"{namespace}/{topics.JOINT_STATES}", field, axis, source))
        else:
            curves.append(Curve(measured, "data", None, scene.BOARD))
        yield Plot(f"{joints[axis]}: {quantity.title} [{quantity.unit}]", tuple(curves))


def _residual(axis: int, joints: Sequence[str], twin: str) -> Plot:
    field, unit = next(iter(scene.RESIDUALS.items()))
    curve = Curve(f"{twin}/{topics.RESIDUAL}", field, axis, scene.RESIDUAL)
    return Plot(f"{joints[axis]}: residual {field} [{unit}]", (curve,))


def _splitter(parent: ElementTree.Element, orientation: str, count: int) -> ElementTree.Element:
    sizes = ";".join([f"{1.0 / count:.6f}"] * count)
    return ElementTree.SubElement(parent, "DockSplitter", orientation=orientation, count=str(count), sizes=sizes)


def _nested(parts: Sequence[Any], direction: str) -> Any:
    """Equal parts, one beside the rest."""
    first, *rest = parts
    if not rest:
        return first
    share = 100.0 / len(parts)
    return {
        "first": first,
        "second": _nested(rest, direction),
        "direction": direction,
        "splitPercentage": share,
    }
