"""``python -m targets``: record on the host, replay on all targets, print one line per target."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from targets.comparison import Expectation, Report, check, combined
from targets.machines import TARGETS, missing_text
from targets.recording import Recorder, Recording
from targets.rig import RigError
from targets.scenarios import SCENARIOS
from targets.sources import Sources
from targets.toolchain import TargetError


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0 if all targets agree with the host, 1 if one differs, or is missing with ``--all``."""
    options = _parser().parse_args(arguments)
    chosen = [target for target in TARGETS if not options.target or target.name in options.target]
    present = [target for target in chosen if target.available()]
    missing = [target for target in chosen if target not in present]
    agree = True
    with tempfile.TemporaryDirectory(prefix="targets-") as name:
        folder = Path(name)
        sources = Sources().copy(folder / "sources")
        try:
            expected = _expectations(sources, folder, options.scenario, options.seed)
        except (TargetError, RigError) as error:
            print(f"recording failed: {error}", file=sys.stderr)
            return 1
        digest = combined([one.digest for one in expected])
        print(f"{'recorded on the host':20} {digest:08X}          {_contents(expected)}", flush=True)
        for report in check(present, expected, sources, folder):
            agree = _print(report) and agree
    for target in missing:
        print(f"{target.name:20} skipped            {missing_text(target)}")
    print(_summary(len(present), len(missing), agree))
    return 0 if agree and not (missing and options.all) else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="targets", description=__doc__)
    names = ", ".join(target.name for target in TARGETS)
    scenarios = [scenario.name for scenario in SCENARIOS]
    parser.add_argument("--target", action="append", choices=[t.name for t in TARGETS], metavar="NAME", help=names)
    parser.add_argument("--scenario", action="append", choices=scenarios, metavar="NAME", help=", ".join(scenarios))
    parser.add_argument("--seed", type=int, default=1, help="seed of the noise of the board and of the arithmetic")
    parser.add_argument("--all", action="store_true", help="fail if a target is skipped because of a missing tool")
    return parser


def _expectations(sources: Sources, folder: Path, names: Sequence[str] | None, seed: int) -> list[Expectation]:
    recorder = Recorder(sources, folder)
    chosen = [scenario for scenario in SCENARIOS if not names or scenario.name in names]
    recordings: list[Expectation] = [recorder.record(scenario, seed) for scenario in chosen]
    return recordings if names else [*recordings, recorder.arithmetic(seed)]


def _contents(expected: Sequence[Expectation]) -> str:
    periods = sum(one.periods for one in expected if isinstance(one, Recording))
    return f"{len(expected)} runs, {periods} PWM periods: {', '.join(one.name for one in expected)}"


def _print(report: Report) -> bool:
    value = "--------" if report.digest is None else f"{report.digest:08X}"
    verdict = "" if report.agrees else "  DIFFERS"
    print(f"{report.target.name:20} {value} {report.seconds:6.1f} s  {report.target.about}{verdict}", flush=True)
    for problem in report.problems:
        print("    " + problem.replace("\n", "\n    "))
    return report.agrees


def _summary(run: int, skipped: int, agree: bool) -> str:
    text = f"{run} targets {'agree with' if agree else 'do not all agree with'} the recording"
    return f"{text}; {skipped} skipped" if skipped else text


if __name__ == "__main__":
    sys.exit(main())
