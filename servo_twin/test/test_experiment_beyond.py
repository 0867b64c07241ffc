"""What goes beyond the reference design helps, and the figures notice when it is not switched on."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest
from servo_twin.experiments import feed_forward, field_weakening, friction, rig, soft_limits, supervision
from servo_twin.plant import PlantConfig


def run(module: ModuleType) -> list[str]:
    """Figures that do not agree."""
    return [row.name for row in module.run(PlantConfig.load(), 3).rows if not row.agrees]


@pytest.mark.parametrize(
    "module", [feed_forward, field_weakening, friction, soft_limits, supervision], ids=lambda m: m.NAME
)
def test_agrees(module: ModuleType) -> None:
    assert run(module) == []


@pytest.mark.parametrize(
    ("module", "figure"),
    [
        (feed_forward, "following error"),
        (field_weakening, "speed gained"),
        (friction, "start from rest"),
        (soft_limits, "beyond with"),
        (supervision, "outputs off after"),
    ],
    ids=lambda value: getattr(value, "NAME", ""),
)
def test_notices_that_nothing_is_switched(module: ModuleType, figure: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: Any, **__: Any) -> None: ...

    for where in (module, rig):
        monkeypatch.setattr(where, "features", nothing, raising=False)
    assert any(figure in name for name in run(module))
