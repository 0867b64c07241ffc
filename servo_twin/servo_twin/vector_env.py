"""Vectorised environment of Gymnasium: boards that turn their shafts to target angles (servo_twin/doc/coupling.md)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import TICK_NS

from servo_twin.board import Board
from servo_twin.board_state import BoardState
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable

_VARIABLES: Final = {"SPEED": "cmd.speed", "TORQUE": "cmd.i_q"}
_COLUMNS: Final = ("position", "speed", "i_q")

_Array = NDArray[np.float32]


class BoardVectorEnv(VectorEnv[_Array, _Array, NDArray[Any]]):
    """Boards at level ``ideal``, each with two shafts; they run in threads, without the GIL.

    An action is a speed [rad/s] or a current [A] per axis. An observation has for each axis position [rad], speed
    [rad/s], current [A] and target [rad]. The reward of a step is minus the distance of both axes from their
    targets [rad] times its duration [s]. An episode ends with a fault of an axis, and after `steps` steps; the next
    step then begins a new one (`AutoresetMode.NEXT_STEP`).

    Parameters
    ----------
    num_envs : int
        Number of boards.
    mode : {"TORQUE", "SPEED"}
        Meaning of the action.
    period : float
        Duration of a step [s], a multiple of 0.5 ms.
    steps : int
        Steps of an episode.
    reach : float
        Targets are within this distance from the start [rad].
    states : sequence of BoardState, optional
        States with axes in position hold, one of which is drawn for every episode; by default of four boards after
        their rotor search.
    plant : PlantConfig, optional
        Plant of the default states.
    threads : int, optional
        Number of threads; by default that of the processors.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        mode: Literal["TORQUE", "SPEED"] = "TORQUE",
        period: float = 0.005,
        steps: int = 200,
        reach: float = 3.0,
        states: Sequence[BoardState] | None = None,
        plant: PlantConfig | None = None,
        threads: int | None = None,
    ) -> None:
        self._step_ns = round(period * 1e9)
        if self._step_ns < TICK_NS or self._step_ns % TICK_NS:
            raise ValueError(f"the period {period:g} s is not a multiple of 0.5 ms")
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        self.num_envs, self._steps, self._reach = num_envs, steps, reach
        self._boards = [Board(plant, level="ideal") for _ in range(num_envs)]
        catalogue = self._boards[0].catalogue
        self._variable = catalogue[_VARIABLES[mode]]
        self._mode = [catalogue.enums["control_mode_t"][mode]] * AXES
        self._largest = np.full(AXES, self._variable.maximum, np.float32)
        self.single_action_space = gymnasium.spaces.Box(-self._largest, self._largest)
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (AXES, len(_COLUMNS) + 1))
        batch = gymnasium.vector.utils.batch_space
        self.action_space = batch(self.single_action_space, num_envs)
        self.observation_space = batch(self.single_observation_space, num_envs)
        self._pool = ThreadPoolExecutor(threads or os.cpu_count())
        self._states = list(states or self._pool.map(lambda seed: _ready(plant, seed), range(4)))
        self._names = [f"{axis_name(axis)}.{column}" for axis in range(AXES) for column in _COLUMNS]
        self._targets = np.zeros((num_envs, AXES), np.float32)
        self._left = np.zeros(num_envs, np.int64)  # steps of the present episode
        self._ended = np.ones(num_envs, np.bool_)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[_Array, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self._ended[:] = True
        return self._run(np.zeros((self.num_envs, AXES), np.float32))[0], {}

    def step(self, actions: _Array) -> tuple[_Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        if not np.isfinite(actions).all():
            raise ValueError(f"the action of environment {np.argwhere(~np.isfinite(actions))[0][0]} is not finite")
        begins = self._ended.copy()
        observations, faults = self._run(np.clip(actions, -self._largest, self._largest))
        errors = np.abs(observations[:, :, 0] - self._targets).sum(axis=1)
        rewards = np.where(begins, 0.0, -errors * self._step_ns * 1e-9)
        truncated = (self._left <= 0) & ~faults
        self._ended = faults | truncated
        return observations, rewards, faults, truncated, {}

    def _run(self, actions: _Array) -> tuple[_Array, NDArray[np.bool_]]:
        """Begin the episodes that are due, let the others run for a step; observations and faults."""
        count = int(self._ended.sum())
        starts = self.np_random.integers(len(self._states), size=count)
        self._targets[self._ended] = self.np_random.uniform(-self._reach, self._reach, (count, AXES))
        self._left = np.where(self._ended, self._steps, self._left - 1)
        start = iter(starts.tolist())
        works = [(k, next(start) if self._ended[k] else None, actions[k]) for k in range(self.num_envs)]
        rows = np.array(list(self._pool.map(self._run_one, works)))
        values = rows[:, :-1].reshape(self.num_envs, AXES, len(_COLUMNS))
        self._ended[:] = False
        return np.concatenate([values, self._targets[:, :, None]], axis=2).astype(np.float32), rows[:, -1] > 0.0

    def _run_one(self, work: tuple[int, int | None, _Array]) -> list[float]:
        """Values of `_names`, and whether an axis has a fault."""
        index, start, action = work
        board = self._boards[index]
        if start is not None:
            board.restore(self._states[start])
            board.write_words("cmd.mode", self._mode)
        board.write_words(self._variable.name, [self._variable.to_raw(float(value)) for value in action])
        snapshot = board.record(board.time_ns + self._step_ns)[-1]
        faults = any(snapshot[f"{axis_name(axis)}.faults"] for axis in range(AXES))
        return [*(float(snapshot[n]) * board.catalogue[n].lsb for n in self._names), float(faults)]

    def close_extras(self, **kwargs: Any) -> None:
        """Free the boards."""
        self._pool.shutdown()
        for board in self._boards:
            board.close()


def _ready(plant: PlantConfig | None, seed: int) -> BoardState:
    with Board(plant, seed=seed, level="ideal") as board:
        enable(board)
        return board.state()
