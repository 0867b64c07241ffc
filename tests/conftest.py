"""What these tests share: the recorded runs; and for all tests, that none may be skipped where that is asked for."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import Any

import pytest
from targets.comparison import Expectation
from targets.machines import Target, missing_text
from targets.recording import Arithmetic, Recorder, Recording
from targets.scenarios import SCENARIOS
from targets.sources import Sources

# A shell in the background may have Ctrl-C ignored, and the processes that the tests start would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Before test modules are imported: nodes of two workers must not discover each other.
_WORKER = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
if "ROS_DOMAIN_ID" in os.environ:
    os.environ["ROS_DOMAIN_ID"] = str(int(os.environ["ROS_DOMAIN_ID"]) + int(_WORKER.removeprefix("gw")))

SKIP_NOTHING = "TESTS_SKIP_NOTHING"
ALLOWED = (
    "root may write everywhere",
    "no `ros2 launch`: it has no wheel; source a ROS 2, or `make launch-tools`",
)
"""Reasons that are not the want of a tool."""


_CRASHED = pytest.StashKey[bool]()


def _unexpected_skips(config: pytest.Config) -> list[str]:
    """Reasons for which tests were skipped where every tool has to be there."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if SKIP_NOTHING not in os.environ or reporter is None:
        return []
    reasons = {str(report.longrepr[2]).removeprefix("Skipped: ") for report in reporter.stats.get("skipped", ())}
    return sorted(reasons - set(ALLOWED))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Where processes share the work, files with slow tests come first, so that all end at about the same time."""
    if hasattr(config, "workerinput"):
        slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
        items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """A process of pytest-xdist has ended; with an error, some tests may not have been run."""
    if error:
        node.config.stash[_CRASHED] = True


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """A crashed process, or a test skipped where every tool has to be there; to repeat failed tests does not help."""
    crashed = session.config.stash.get(_CRASHED, False)
    if crashed or _unexpected_skips(session.config):
        session.exitstatus = pytest.ExitCode.INTERNAL_ERROR


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for reason in _unexpected_skips(config):
        terminalreporter.write_line(f"{SKIP_NOTHING} is set, but a test was skipped: {reason}", red=True)


@pytest.fixture(scope="session")
def c_sources(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    """The C sources of this moment."""
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
