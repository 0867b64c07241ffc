"""The launch file against stand-ins for the launch packages, which exist only where ROS is installed."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

FILE = Path(__file__).resolve().parents[1] / "launch" / "bridge.launch.py"
EXECUTABLES = {("servo_bridge", "servo_bridge"), ("servo_twin", "servo_twin"), ("servo_twin", "servo_viewer"),
               ("servo_twin", "virtual_board")}  # fmt: skip


class Part:
    """Any action, condition or substitution: remembers what it was made of."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.positional, self.named = positional, named


def _stand_in(monkeypatch: pytest.MonkeyPatch, name: str, *classes: str) -> dict[str, type[Part]]:
    module = ModuleType(name)
    made = {each: type(each, (Part,), {}) for each in classes}
    for each, kind in made.items():
        setattr(module, each, kind)
    monkeypatch.setitem(sys.modules, name, module)
    return made


def test_every_node_is_described_with_names_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    _stand_in(monkeypatch, "launch", "LaunchDescription")
    _stand_in(monkeypatch, "launch.actions", "DeclareLaunchArgument", "EmitEvent", "RegisterEventHandler")
    _stand_in(monkeypatch, "launch.conditions", "IfCondition")
    _stand_in(monkeypatch, "launch.event_handlers", "OnProcessExit")
    _stand_in(monkeypatch, "launch.events", "Shutdown")
    values = _stand_in(monkeypatch, "launch.substitutions", "LaunchConfiguration")["LaunchConfiguration"]
    _stand_in(monkeypatch, "launch_ros", "actions")
    nodes = _stand_in(monkeypatch, "launch_ros.actions", "Node")["Node"]
    _stand_in(monkeypatch, "launch_ros.parameter_descriptions", "ParameterValue")
    packages = ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = lambda name: str(FILE.parents[1])  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ament_index_python", ModuleType("ament_index_python"))
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", packages)

    spec = importlib.util.spec_from_file_location("bridge_launch", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    parts = module.generate_launch_description().positional[0]

    found = {(n.named["package"], n.named["executable"]): n.named for n in parts if isinstance(n, nodes)}
    assert set(found) == EXECUTABLES
    assert found["servo_bridge", "servo_bridge"]["namespace"] == "servo"
    assert found["servo_twin", "servo_twin"]["namespace"] == "twin"
    assert found["servo_twin", "virtual_board"]["arguments"][::2] == ["--link", "--baud"]
    parameters = found["servo_bridge", "servo_bridge"]["parameters"]
    assert isinstance(parameters[0], values)
    assert set(parameters[1]) == {"port", "baud"}
    assert Path(module.ARGUMENTS["params"][0]).is_file()
