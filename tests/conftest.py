"""Shared fixtures: the recorded runs; and for all tests the option that forbids skipped tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import common_rig  # noqa: F401
import pytest
from targets.comparison import Expectation
from targets.machines import CortexM4, Target, missing_text
from targets.recording import Arithmetic, Recorder, Recording
from targets.scenarios import SCENARIOS
from targets.sources import Sources

# Set before test modules are imported: nodes of two workers must not discover each other.
_WORKER = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
if "ROS_DOMAIN_ID" in os.environ:
    os.environ["ROS_DOMAIN_ID"] = str(int(os.environ["ROS_DOMAIN_ID"]) + int(_WORKER.removeprefix("gw")))

SKIP_NOTHING = "TESTS_SKIP_NOTHING"
ALLOWED = (
    "root can write everywhere",
    "no `ros2 launch`: it has no wheel; source a ROS 2, or `make launch-tools`",
)
"""Allowed reasons of a skip: not a missing tool."""


_CRASHED = pytest.StashKey[bool]()


def _unexpected_skips(config: pytest.Config) -> list[str]:
    """Reasons of skipped tests that are not allowed, if all tools are required."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if SKIP_NOTHING not in os.environ or reporter is None:
        return []
    reasons = {str(report.longrepr[2]).removeprefix("Skipped: ") for report in reporter.stats.get("skipped", ())}
    return sorted(reasons - set(ALLOWED))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Start files with slow tests first in parallel runs, so that all workers end at about the same time.

    The run in real time of `make test` collects only files that contain the text of the mark.
    """
    for path in {item.path for item in items if item.get_closest_marker("realtime") is not None}:
        if "mark.realtime" not in path.read_text(encoding="utf-8"):
            raise pytest.UsageError(f"{path}: write pytest.mark.realtime in this file, not elsewhere")
    if hasattr(config, "workerinput"):
        slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
        items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """Note a crashed pytest-xdist worker: some tests may not have been run."""
    if error:
        node.config.stash[_CRASHED] = True


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Report an internal error, not failed tests, for a crashed worker or a skip that is not allowed."""
    crashed = session.config.stash.get(_CRASHED, False)
    if crashed or _unexpected_skips(session.config):
        session.exitstatus = pytest.ExitCode.INTERNAL_ERROR


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for reason in _unexpected_skips(config):
        terminalreporter.write_line(f"{SKIP_NOTHING} is set, but a test was skipped: {reason}", red=True)


@pytest.fixture(scope="session")
def c_sources(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    """Copy of the present C sources."""
    return Sources().copy(tmp_path_factory.mktemp("sources"))


@pytest.fixture(scope="session")
def recorder(c_sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> Recorder:
    return Recorder(c_sources, tmp_path_factory.mktemp("recorder"))


@pytest.fixture(scope="session")
def recordings(recorder: Recorder) -> list[Recording]:
    """Every scenario, recorded on the host."""
    return [recorder.record(scenario) for scenario in SCENARIOS]


@pytest.fixture(scope="session")
def arithmetic(recorder: Recorder) -> Arithmetic:
    return recorder.arithmetic()


@pytest.fixture(scope="session")
def expected(recordings: list[Recording], arithmetic: Arithmetic) -> list[Expectation]:
    return [*recordings, arithmetic]


@pytest.fixture(scope="session")
def needs() -> Callable[[Target], None]:
    """Skip a test whose target has no tools on this machine."""

    def check(target: Target) -> None:
        if not target.available():
            pytest.skip(missing_text(target))

    return check


@pytest.fixture(scope="session")
def cortex_m4_tools(needs: Callable[[Target], None]) -> None:
    """Skip a test without the tools of a Cortex-M4, before fixtures of its module use them."""
    needs(CortexM4("-O2"))
