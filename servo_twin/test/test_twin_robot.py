"""Twin of a board whose shafts move a robot: the twin's board moves a model of it."""

from __future__ import annotations

from statistics import mean

import pytest
from servo_twin.level import LEVEL_VARIABLE
from twin_rig import TwinRig

pytest.importorskip("mujoco", reason="there is no MuJoCo 4 for Python 3.10")

from servo_twin.robot.command import load
from servo_twin.robot.robot_model import RobotModel

ANGLE = 60.0
"""Of both motors, 34 degrees of the joints of the arm [rad]."""


@pytest.fixture(scope="module")
def arm() -> RobotModel:
    return load("arm")


def lifted(rig: TwinRig) -> None:
    """Enable and lift both links."""
    rig.enable_axes()
    rig.write("cmd.position", [ANGLE, -ANGLE])
    rig.run(1.5)


def effort(rig: TwinRig) -> float:
    """Larger difference of the mean torque-producing currents of an axis in 0.3 s [A]."""
    pairs = rig.run(0.3)
    assert pairs
    assert not any(pair.difference for pair in pairs)
    return max(abs(mean(p.real[name] - p.twin[name] for p in pairs)) for name in ("axis1.i_q", "axis2.i_q"))


@pytest.mark.usefixtures("level")
def test_equal_boards_with_equal_robots_agree_bit_for_bit(arm: RobotModel) -> None:
    with TwinRig(real_seed=3, twin_seed=3, robot=arm, twin_robot=arm) as rig:
        lifted(rig)
        assert max(abs(pair.real["axis1.i_q"]) for pair in rig.pairs[-20:]) > 0.1  # the arm has a weight
        for pair in rig.pairs:
            assert {name: pair.real[name] for name in pair.twin} == pair.twin


def test_twin_takes_the_pose_of_a_robot_that_has_moved(arm: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """A twin that is started late: the weight of the lifted arm is that of the model."""
    monkeypatch.setenv(LEVEL_VARIABLE, "ideal")
    with TwinRig(robot=arm, twin_robot=arm) as rig:
        rig.listening = False
        lifted(rig)
        rig.listening = True
        rig.run(4.0)
        with_model = effort(rig)
        rig.write("cmd.position", [0.5 * ANGLE, -ANGLE])
        rig.run(1.5)
        moved = effort(rig)
    with TwinRig(robot=arm) as rig:
        lifted(rig)
        without = effort(rig)
    assert max(with_model, moved) < 0.1 * without
