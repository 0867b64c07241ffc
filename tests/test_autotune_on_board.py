"""``servo-tool autotune`` and a virtual board with a load on a spring, over its serial line in simulated time."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from servo_measurement.autotune import DISTANCE, Autotuned, AutotuneRequest, autotune
from servo_measurement.position_move import Move
from servo_measurement.resonance import Shaft
from servo_msgs_py.board_port import place, reached
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.reading import read_table
from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.plant import PlantConfig
from servo_twin.sprung_load import SprungLoad
from servo_twin.validation.experiments.rig import set_up
from test_resonance_on_board import KEPT, oscillates
from test_tune_on_board import BAUD, CONFIG, ToolBench, edited

LOAD: Final = SprungLoad(300.0, 1.0, 0.02)
LOW: Final = SprungLoad(60.0, 4.0, 0.02)
"""No bandwidth keeps 60 degrees with it."""
SLOW: Final = SprungLoad(80.0, 5.0, 0.02)
"""With the bandwidths for it, friction holds the shaft away from its target."""

OBSERVER: Final = Catalogue.load().flag("features", "SPEED_OBSERVER").mask


@contextmanager
def with_load(load: SprungLoad) -> Iterator[ToolBench]:
    plant = PlantConfig.load()
    axes = (load.of(plant.axes[0]), plant.axes[1])
    with Board(plant.with_axis(0, **vars(axes[0])), level="ideal", baud=BAUD, seed=4) as board:
        board.run(0.1)
        yield ToolBench(board)


def state(bench: ToolBench) -> list[list[int]]:
    return [bench.raw(name) for name in KEPT]


def test_confirmed_bandwidths_stay_on_the_board_and_in_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file is that of the board: a second run begins with it."""
    with with_load(LOAD) as bench:
        board, out = bench.board, tmp_path / "out"
        kept = [name for name in KEPT if name not in ("config.checksum", "param.features")]
        others = [bench.raw(name) for name in kept]
        begin = board.clock()
        assert bench.tool("autotune", "axis1", "--out", out, "--json") == 0
        assert board.clock() - begin < 90.0
        assert [bench.raw(name) for name in kept] == others
        found = json.loads(capsys.readouterr().out)
        assert not found["problems"]
        assert found["after"]["control.observer_bandwidth"] < found["before"]["control.observer_bandwidth"]
        assert found["after"]["features.speed_observer"]
        assert bench.raw("param.features")[0] == bench.raw("param.features")[1] | OBSERVER
        assert found["measured"]["phase margin"] > 37.0
        assert found["measured"]["gain margin"] > 1.8
        assert not found["settling before"]  # the model of the present loops is not stable with every possible load
        assert all(time < 1.0 for time in found["settling"])
        assert (out / "autotune.png").read_bytes().startswith(b"\x89PNG")
        assert not oscillates(board)

        assert bench.tool("tune", out / "servo.toml", "--diff") == 0
        assert bench.tool("autotune", "axis1", "--config", out / "servo.toml", "--out", tmp_path / "again") == 0
        assert "confirmed" in capsys.readouterr().out


def test_refused_margin_names_one_that_is_accepted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The board keeps its configuration."""
    with with_load(LOW) as bench:
        before = state(bench)
        assert bench.tool("autotune", "axis1", "--out", tmp_path, "--phase-margin", "60") == 1
        assert state(bench) == before
        limits = ["--phase-margin", option(capsys.readouterr().err, "--phase-margin")]
        assert bench.tool("autotune", "axis1", "--out", tmp_path, *limits) == 0, capsys.readouterr()


def test_what_is_not_confirmed_is_taken_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And the file of an earlier run is removed; with the tolerance that is named it is confirmed."""
    (tmp_path / "servo.toml").write_text("earlier", encoding="utf-8")
    with with_load(SLOW) as bench:
        before = state(bench)
        assert bench.tool("autotune", "axis1", "--out", tmp_path) == 1
        assert state(bench) == before
        assert place(bench.board, 0) == "STOP"
        assert not (tmp_path / "servo.toml").exists()
        assert (tmp_path / "autotune.png").exists()
        tolerance = option(capsys.readouterr().err, "--tolerance")
        assert bench.tool("autotune", "axis1", "--out", tmp_path, "--tolerance", tolerance) == 0


def option(text: str, name: str) -> str:
    """Value that a refusal names."""
    found = re.search(rf"{name} (\S+)", text)
    assert found is not None, text
    return found[1]


@pytest.fixture(scope="module")
def found() -> Autotuned:
    with with_load(LOAD) as bench:
        return autotune(VirtualBoardAccess(bench.board), AutotuneRequest(0, travel_max=20.0), read_table(CONFIG))


def test_the_shaft_stays_within_the_range(found: Autotuned) -> None:
    assert not found.problems
    assert all(np.abs(move.trace["position"]).max() < 20.0 for move in found.moves)
    assert found.moves[0].distance == pytest.approx(DISTANCE)


def lighter(shaft: Shaft) -> Shaft:
    return replace(shaft, parameters=shaft.parameters - np.log([10.0, 1.0, 1.0, 1.0]))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda one: replace(one, confirmed=replace(one.confirmed, squares=1e6)), "is not that of motor and load"),
        (lambda one: replace(one, after=one.before), "unstable"),
        (lambda one: replace(one, request=replace(one.request, phase_min=89.0)), "phase margin"),
        (lambda one: replace(one, confirmed=lighter(one.confirmed)), "gain margin"),
        (lambda one: replace(one, moves=[ended(one.moves[0], 0.03)]), "--tolerance 0.04"),
        (lambda one: replace(one, moves=[ended(one.moves[0], 6.0)]), "axis1.limits"),
        (lambda one: replace(one, moves=[overshot(one.moves[0], 0.9)]), "overshoots by 0.9 rad"),
    ],
)
def test_each_thing_that_is_not_confirmed_is_named(
    found: Autotuned, change: Callable[[Autotuned], Autotuned], reason: str
) -> None:
    assert any(reason in str(problem) for problem in change(found).problems)


def ended(move: Move, error: float) -> Move:
    trace = move.trace.changed(position=move.trace["position"] + error)
    return replace(move, trace=trace, figures=replace(move.figures, arrived=False, error=error))


def overshot(move: Move, overshoot: float) -> Move:
    return replace(move, figures=replace(move.figures, overshoot=overshoot))


def test_features_that_were_switched_stay_as_they_are() -> None:
    """A configuration brings those of its file."""
    with with_load(LOAD) as bench:
        set_up(bench.board, 0, STARVED=True)
        bench.board.run(0.01)
        features = bench.raw("param.features")[0]
        assert not autotune(VirtualBoardAccess(bench.board), AutotuneRequest(0), read_table(CONFIG)).problems
        assert bench.raw("param.features")[0] == features | OBSERVER


def test_ctrl_c_in_the_move_leaves_the_configuration_from_before() -> None:
    """And the shaft at rest, off."""
    with with_load(LOAD) as bench:
        board, before = bench.board, state(bench)
        checksum, waits = bench.raw("config.checksum"), 0

        class Interrupted(VirtualBoardAccess):
            """Ends in a wait of the move with the chosen configuration."""

            def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
                if name == "cmd.position" and board.read_words("config.checksum") != checksum:
                    nonlocal waits
                    waits += 1
                    if waits == 1:
                        raise KeyboardInterrupt
                return super().write_words(name, words, first)

        with pytest.raises(KeyboardInterrupt):
            autotune(Interrupted(board), AutotuneRequest(0), read_table(CONFIG))
        assert state(bench) == before
        assert place(board, 0) == "STOP"


def test_what_cannot_be_tuned_is_refused_without_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with with_load(LOAD) as bench:
        board = bench.board
        board.write("param.host_timeout", 30.0)  # no program sends a keep-alive
        position = bench.raw("axis1.position")

        def refused(text: str, *options: str | Path) -> None:
            assert bench.tool("autotune", "axis1", "--out", tmp_path, *options) == 1
            assert text in capsys.readouterr().err
            assert bench.raw("axis1.position") == position, text

        refused("another configuration", "--config", edited(tmp_path, "my.toml", control={"speed_bandwidth": 21}))
        bench.board.write("cmd.enable", [1, 0])
        assert reached(board, lambda: place(board, 0) == "SPIN", 8.0, 0.05)
        position = bench.raw("axis1.position")
        refused("is enabled")
