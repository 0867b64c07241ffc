"""Example of ``firmware/config/README.md``: the data sheet of a motor as entries of ``servo.toml``."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from servo_msgs_py.text_file import parse_toml
from servo_tuning.assessment import assess
from servo_tuning.findings import findings
from servo_tuning.reading import parse
from servo_tuning.tuned import Tuned, tuned
from tuning_tool import CATALOGUE, table

README = Path(__file__).parents[1] / "config" / "README.md"
RPM = 2.0 * math.pi / 60.0


@pytest.fixture(scope="module")
def motor() -> Tuned:
    (example,) = re.findall(r"```toml\n(\[axis1\.motor\].*?)```", README.read_text(), re.DOTALL)
    configuration = parse({**table(), "axis1": parse_toml(example)["axis1"]}, CATALOGUE)
    return tuned(configuration.axes[0], configuration)


def test_the_example_has_neither_a_refusal_nor_a_warning(motor: Tuned) -> None:
    assert list(map(str, findings(motor, assess(motor)))) == []


def test_the_example_has_the_figures_of_its_data_sheet(motor: Tuned) -> None:
    it, rated = motor.motor, motor.axis("motor.rated_current")
    block = 3.0 / math.pi * math.sqrt(3.0) * it.psi_m * it.pole_pairs  # torque constant of a block commutation
    assert block == pytest.approx(0.0404, rel=1e-3)
    assert 1.0 / block == pytest.approx(236.0 * RPM, rel=1e-2)
    assert (24.0 - 2.0 * it.r_s * 0.27) / block == pytest.approx(5600.0 * RPM, rel=1e-2)
    loss = motor.axis("friction.coulomb") + motor.axis("friction.viscous") * 5600.0 * RPM
    assert it.torque_constant * rated - loss == pytest.approx(0.134, rel=0.06)
    assert 1.5 * it.r_s * rated**2 == pytest.approx(0.573 * 3.29**2, rel=1e-2)
    assert motor.axis("motor.rated_speed") == pytest.approx(4750.0 * RPM, rel=1e-3)
