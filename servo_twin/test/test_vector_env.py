"""Boards as a vectorised environment of Gymnasium."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium")

from servo_twin.vector_env import BoardVectorEnv


def pd(observation: Any) -> Any:
    """Current by position and speed."""
    position, speed, _, target = np.moveaxis(observation, -1, 0)
    return np.clip(0.3 * (target - position) - 0.02 * speed, -2.0, 2.0).astype(np.float32)


def episode(env: BoardVectorEnv, seed: int, steps: int) -> tuple[Any, Any]:
    observation, _ = env.reset(seed=seed)
    observations, rewards = [observation], []
    for _ in range(steps):
        observation, reward, terminated, _, _ = env.step(pd(observation))
        assert not terminated.any()
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations), np.array(rewards)


def test_shafts_reach_their_targets_and_episodes_repeat() -> None:
    env = BoardVectorEnv(3, steps=120, threads=2)
    assert env.action_space.shape == (3, 2)
    observations, rewards = episode(env, 7, 120)
    assert observations[-1] in env.observation_space
    assert np.abs(observations[-1, :, :, 0] - observations[-1, :, :, 3]).max() < 0.2  # friction
    assert len(np.unique(observations[0, :, :, 3])) == 6  # a target of its own for each axis
    assert rewards[0].max() < rewards[-1].min() <= 0.0
    again, _ = episode(env, 7, 120)
    assert np.array_equal(observations, again)
    observation, reward, _, truncated, _ = env.step(pd(again[-1]))  # begins the next episode
    assert not reward.any()
    assert not truncated.any()
    assert np.abs(observation[:, :, 0]).max() < 0.1
    env.close()


def test_fault_ends_an_episode_and_invalid_actions_are_refused() -> None:
    env = BoardVectorEnv(2, mode="SPEED", steps=10)
    env.reset(seed=1)
    env._boards[1].connect_motor(0, False)
    action = np.full((2, 2), 100.0, np.float32)
    ended = np.zeros(2, bool)
    for _ in range(9):
        ended |= env.step(action)[2]
    assert ended.tolist() == [False, True]
    assert env.step(action)[3].tolist() == [True, False]
    action[1, 0] = math.nan
    with pytest.raises(ValueError, match="environment 1 is not finite"):
        env.step(action)
    with pytest.raises(ValueError, match=r"multiple of 0.5 ms"):
        BoardVectorEnv(1, period=0.0007)
    env.close()
