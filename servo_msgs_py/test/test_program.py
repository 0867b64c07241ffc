"""Start and end of programs: signals, closed pipes, full disks."""

from __future__ import annotations

import ast
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import common_rig
import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("servo_bridge", "servo_twin")
ENTRIES = [
    (package, function)
    for package in PACKAGES
    for function in (
        node.name
        for node in ast.parse((ROOT / package / package / "programs.py").read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
    )
]
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
PROGRAM = """
import os, signal, sys, time
from servo_msgs_py.runtime import program as p

@p.program("demo")
def main():
    {body}

sys.exit(main())
"""


def run(code: str, stdout: int | None = subprocess.PIPE, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        [sys.executable, "-c", code], stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=60, **options
    )


def body(*lines: str) -> str:
    return PROGRAM.format(body="\n    ".join(lines))


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(("package", "function"), ENTRIES)
def test_signal_during_the_imports_ends_every_program_quietly(
    package: str, function: str, number: signal.Signals
) -> None:
    """The heavy modules of a program are imported by `run`, after its handlers are installed."""
    result = run(
        "import signal, sys\n"
        f"from {package} import programs\n"
        "heavy = {'numpy', 'rclpy', 'serial', 'cffi'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "import servo_msgs_py.runtime.program as p\n"
        f"p.import_module = lambda name: signal.raise_signal({int(number)})\n"
        f"sys.exit(programs.{function}())\n"
    )
    assert (result.returncode, result.stdout, result.stderr) == (128 + number, "", "")


@pytest.mark.parametrize("package", PACKAGES)
def test_scripts_differ_only_in_the_function_of_programs(package: str) -> None:
    scripts = [path.read_text(encoding="utf-8") for path in (ROOT / package / "scripts").iterdir()]
    functions = [re.findall(rf"from {package}\.programs import (\w+)\n", script)[0] for script in scripts]
    assert {(package, function) for function in functions} == {entry for entry in ENTRIES if entry[0] == package}
    texts = {re.sub(rf"\b{name}(?=\n\n|\(\))", "", text) for name, text in zip(functions, scripts, strict=True)}
    assert len(texts) == 1


@pytest.mark.parametrize("script", [path for package in PACKAGES for path in (ROOT / package / "scripts").iterdir()])
def test_ctrl_c_from_the_first_moment_on_ends_every_program_quietly(script: Path) -> None:
    """Python of the environment starts twice if ROS is installed as wheels, with many imports before the program."""
    for delay in (0.0, 0.02, 0.05):
        process = subprocess.Popen(
            [Path(sys.prefix) / "bin" / script.name, "--help"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=60)[1] == ""


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_raises_once_and_gives_the_status(number: signal.Signals) -> None:
    result = run(
        body(
            "try:",
            f"    os.kill(os.getpid(), {int(number)})",
            "    time.sleep(60)",
            "finally:",
            f"    os.kill(os.getpid(), {int(number)})",  # a second one does not disturb the clean-up
            "    print('cleaned up')",
        )
    )
    assert (result.returncode, result.stdout, result.stderr) == (128 + number, "cleaned up\n", "")


@pytest.mark.parametrize("number", SIGNALS)
def test_deferred_signal_is_raised_by_the_check(number: signal.Signals) -> None:
    result = run(
        body(
            "with p.deferred() as stop:",
            f"    os.kill(os.getpid(), {int(number)})",
            "    print('goes on', stop.requested)",
            "    try:",
            "        stop.check()",
            "    finally:",
            "        stop.check()",
            "        print('cleaned up')",
        )
    )
    assert (result.returncode, result.stdout, result.stderr) == (128 + number, "goes on True\ncleaned up\n", "")


def test_signal_after_a_deferred_block_is_raised_at_once() -> None:
    result = run(body("with p.deferred(): pass", "os.kill(os.getpid(), 15)", "print('not reached')"))
    assert (result.returncode, result.stdout) == (143, "")


def test_nohup_is_respected() -> None:
    result = run(
        body("os.kill(os.getpid(), signal.SIGHUP)", "print('goes on')", "return 0"),
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    assert (result.returncode, result.stdout) == (0, "goes on\n")


def test_a_test_run_has_the_signals_of_a_terminal() -> None:
    """Whatever started it: programs under test inherit what is ignored or blocked."""

    def background() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    result = run(
        "import runpy, signal\n"
        f"runpy.run_path({common_rig.__file__!r})\n"
        f"handlers = [signal.getsignal(number) for number in {[int(number) for number in SIGNALS]}]\n"
        "assert handlers == [signal.default_int_handler, signal.SIG_DFL, signal.SIG_DFL], handlers\n"
        "assert not signal.pthread_sigmask(signal.SIG_BLOCK, [])\n",
        preexec_fn=background,
    )
    assert (result.returncode, result.stderr) == (0, "")


def test_closed_terminal_does_not_disturb_the_clean_up() -> None:
    """Output to a terminal that is gone is an error; after SIGHUP it goes nowhere."""
    controller, terminal = os.openpty()
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            body(
                "try:",
                "    print('begun', flush=True)",
                "    time.sleep(60)",
                "finally:",
                "    print('text', flush=True); print('text', file=sys.stderr, flush=True)",
                "    open(os.environ['DONE'], 'w').close()",
            ),
        ],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env=os.environ | {"DONE": (done := os.fspath(Path(os.environ.get("TMPDIR", "/tmp")) / f"done-{os.getpid()}"))},
        start_new_session=True,
    )
    os.close(terminal)
    assert b"begun" in os.read(controller, 100)
    os.close(controller)
    process.send_signal(signal.SIGHUP)
    try:
        assert process.wait(30) == 129
        assert Path(done).exists()
    finally:
        Path(done).unlink(missing_ok=True)


@pytest.mark.parametrize("ending", ["return 0", "sys.exit(0)", "print('x' * 100000); return 0"])
def test_closed_pipe_is_quiet(ending: str) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", body("sys.stdin.read(1)", "print('text')", ending)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
    )
    assert process.stdout is not None
    assert process.stdin is not None
    assert process.stderr is not None
    process.stdout.close()
    process.stdin.write(b"x")
    process.stdin.close()
    errors = process.stderr.read()
    assert (process.wait(30), errors) == (141, b"")


@pytest.mark.parametrize(
    ("line", "status", "text"),
    [
        ("print('text'); return 0", 1, "demo: No space left on device"),
        ("open('/dev/full', 'w').write('x' * 100000)", 1, "demo: No space left on device"),
        ("open('/none/file')", 2, "demo: /none/file: No such file or directory"),
        ("open('/')", 2, "demo: /: Is a directory"),
    ],
)
def test_errors_of_files_name_file_and_reason(line: str, status: int, text: str) -> None:
    with open("/dev/full", "w") as full:
        result = run(body(line), stdout=full.fileno())
    assert (result.returncode, result.stderr.strip()) == (status, text.replace("demo: No", "demo: output: No"))


def test_forked_worker_ends_by_its_signal() -> None:
    result = run(
        body(
            "ready, begun = os.pipe()",
            "worker = os.fork()",
            "if not worker: os.write(begun, b'x'); time.sleep(20)",
            "os.read(ready, 1)",
            "os.kill(worker, signal.SIGTERM)",
            "return os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1]) + 100",
        )
    )
    assert (result.returncode, result.stderr) == (100 - signal.SIGTERM, "")
