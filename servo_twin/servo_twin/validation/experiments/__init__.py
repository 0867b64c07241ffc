"""Experiments of the reference design, repeated on the virtual board in simulated time.

One module per experiment: ``NAME``, ``HELP`` (results of the reference design) and ``run(plant, seed) -> Outcome``.
Bounds follow from the reference design or from the physics of the given plant, never from an earlier run.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Final

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.outcome import Outcome


@dataclass(frozen=True)
class Experiment:
    """An entry of the registry."""

    name: str  # name on the command line
    help: str  # text for the command line
    run: Callable[[PlantConfig, int], Outcome]  # the experiment on a plant with a seed
    add_options: Callable[[argparse.ArgumentParser], None] | None = None  # adds its options to a parser
    with_options: Callable[[argparse.Namespace], Callable[[PlantConfig, int], Outcome]] | None = None
    """Creates the experiment from parsed options."""


def _entry(module: ModuleType) -> Experiment:
    options = (getattr(module, name, None) for name in ("add_options", "with_options"))
    return Experiment(module.NAME, module.HELP, module.run, *options)


_MODULES: Final = """
    anti_windup position rotor_search mt_speed path_filter stiffness low_speed bus_ripple two_axes braking feed_forward
    friction speed_observer soft_limits homing supervision field_weakening pins observer start_up minimum_speed
    sensorless_load_step sensorless_stall winding plant_effects fault_matrix fault_campaign motor_campaign
    hidden_change resonance
"""

EXPERIMENTS: Final[Mapping[str, Experiment]] = {
    entry.name: entry for entry in (_entry(import_module(f"{__name__}.{module}")) for module in _MODULES.split())
}
"""Experiments by name, in the order of ``servo-sim experiment all``."""
