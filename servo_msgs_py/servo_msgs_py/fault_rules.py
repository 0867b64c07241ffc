"""Priority table of faults in the firmware (``diagnosis/fault_rules.c``) as a document."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from servo_msgs_py.catalogue import Catalogue, CatalogueError

_RULE: Final = re.compile(r"\[FINDING_(\w+)\] = \{FAULT_(\w+), ([\w| ]+), (?:FAULT_(\w+)|0)\}, /\* (.+) \*/")
_CAUSE: Final = re.compile(r"\{(\w+), FAULT_(\w+)\}, /\* (.+) \*/")
_REVISION: Final = re.compile(r"\{FAULT_(\w+), (\d+), ([\w| ]+), ([\w| ]+)\}, /\* (.+) \*/")
_RAISED: Final = re.compile(r"(?<!== FOUND\()\bFINDING_([A-Z_]+)")
_COMMENT: Final = re.compile(r"/\*.*?\*/", re.DOTALL)
_PARTS: Final = {"NO_PHASE_CURRENT": "PHASE"}
_PERIODS_PER_MS: Final = 16


@dataclass(frozen=True)
class Rule:
    """Assignment of a fault to a finding of a monitor."""

    finding: str
    fault: str
    instead: tuple[str, ...]  # suspected causes that replace `fault`
    otherwise: str  # fault if `fault` is not enabled; empty if the finding does not stop the axis then
    text: str


@dataclass(frozen=True)
class Suspicion:
    """A suspected cause and the fault that is reported for it."""

    name: str
    fault: str
    text: str


@dataclass(frozen=True)
class Revision:
    """A cause that is detected up to `within` PWM periods after its consequence."""

    fault: str
    within: int
    after: tuple[str, ...]
    voids: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class FaultRules:
    """The tables of ``fault_rules.c``, in their order."""

    rules: tuple[Rule, ...]
    suspicions: tuple[Suspicion, ...]
    revisions: tuple[Revision, ...]

    @classmethod
    def parse(cls, source: str) -> FaultRules:
        """Read the C source.

        Raises
        ------
        CatalogueError
            If the format of a row is not recognised.
        """
        defined = re.search(r"#define CURRENT_DERIVED_FAULTS\s(.*?)\n\n", source, re.DOTALL)
        derived = tuple(re.findall(r"FAULT_(\w+)", defined.group(1))) if defined else ()

        def faults(text: str) -> tuple[str, ...]:
            return (*(derived if "CURRENT_DERIVED_FAULTS" in text else ()), *re.findall(r"\bFAULT_(\w+)", text))

        def suspects(text: str) -> tuple[str, ...]:
            return tuple(_PARTS.get(name, name) for name in text.split(" | ") if name != "0")

        return cls(
            tuple(Rule(a, b, suspects(c), d, e) for a, b, c, d, e in _rows(source, "fault_rules", _RULE)),
            tuple(Suspicion(*row) for row in _rows(source, "fault_causes", _CAUSE)),
            tuple(
                Revision(a, int(b), faults(c), faults(d), e)
                for a, b, c, d, e in _rows(source, "fault_revisions", _REVISION)
            ),
        )


def _rows(source: str, table: str, row: re.Pattern[str]) -> list[tuple[str, ...]]:
    """Match groups of each row of a table."""
    found = re.search(rf" {table}\[\w*\] = \{{\n(.*?)\n\}};", source, re.DOTALL)
    if found is None:
        raise CatalogueError(f"fault_rules.c has no table {table}")
    rows = []
    for line in found.group(1).splitlines():
        match = row.fullmatch(line.strip())
        if match is None:
            raise CatalogueError(f"fault_rules.c, table {table}: this row cannot be read: {line.strip()}")
        rows.append(tuple(group or "" for group in match.groups()))
    return rows


def _names(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def raised_in(firmware: Path) -> dict[str, list[str]]:
    """Sources in which each finding is raised, relative to the folder of the firmware."""
    sources: dict[str, list[str]] = {}
    for folder in ("diagnosis", "drive", "app"):
        for path in sorted((firmware / folder).glob("*.[ch]")):
            if path.name not in {"evidence.h", "fault_rules.c"}:
                code = _COMMENT.sub("", path.read_text(encoding="utf-8"))
                for finding in sorted(set(_RAISED.findall(code))):
                    sources.setdefault(finding, []).append(f"{folder}/{path.name}")
    return sources


def fault_list(catalogue: Catalogue, rules: FaultRules, sources: Mapping[str, list[str]]) -> str:
    """List of the faults: priority table, suspicions, causes and remedies, as Markdown.

    Parameters
    ----------
    catalogue : Catalogue
    rules : FaultRules
    sources : Mapping
        Sources in which each finding is raised (`raised_in`).

    Raises
    ------
    CatalogueError
        If the firmware contains a fault that is not in the catalogue, a fault has no finding, or a finding is never
        raised.
    """
    known = {fault.name: fault for fault in catalogue.flags["faults"]}
    if set(known) != {rule.fault for rule in rules.rules}:
        raise CatalogueError(f"faults without a finding, or unknown: {set(known) ^ {r.fault for r in rules.rules}}")
    if missing := {rule.finding for rule in rules.rules} - set(sources):
        raise CatalogueError(f"findings that no source raises: {', '.join(sorted(missing))}")
    causes = {suspicion.name: suspicion.fault for suspicion in rules.suspicions}
    lines = [
        "# Faults",
        "",
        "Generated by `make generate` from `firmware/diagnosis/fault_rules.c` and `servo_msgs_py/variables.toml`.",
        "",
        "The sources in the last column raise a *finding*. The first fault is that of the first row that is raised. If",
        "a monitor suspects a cause that explains the finding, that cause is reported instead. Faults not in",
        "`param.faults_enabled` are skipped; a finding that must stop the axis is then reported as in the column",
        "'if not enabled'.",
        "",
        "| priority | finding | condition | fault | instead, if suspected | if not enabled | raised in |",
        "|---:|---|---|---|---|---|---|",
    ]
    for number, rule in enumerate(rules.rules, 1):
        instead = _names(fault for name, fault in causes.items() if name in rule.instead)
        finding = rule.finding.lower().replace("_", " ")
        otherwise = _names(filter(None, [rule.otherwise]))
        raised = ", ".join(f"[{Path(path).name}](../{path})" for path in sources[rule.finding])
        lines.append(f"| {number} | {finding} | {rule.text} | `{rule.fault}` | {instead} | {otherwise} | {raised} |")
    lines += ["", "## Suspicions", "", "In order of priority.", "", "| suspected fault | when |", "|---|---|"]
    lines += [f"| `{suspicion.fault}` | {suspicion.text} |" for suspicion in rules.suspicions]
    lines += ["", "## Causes detected later", "", "They replace the first fault.", ""]
    lines += ["| cause | detected within | after | removes | reason |", "|---|---|---|---|---|"]
    for revision in rules.revisions:
        within = f"{revision.within / _PERIODS_PER_MS:g} ms"
        voids = "the same except `OVER_CURRENT`" if len(revision.voids) > 1 else _names(revision.voids)
        lines.append(f"| `{revision.fault}` | {within} | {_names(revision.after)} | {voids} | {revision.text} |")
    lines += ["", "## Causes and remedies", "", "| fault | cause | remedy | can be disabled |", "|---|---|---|---|"]
    lines += [f"| `{f.name}` | {f.cause} | {f.remedy} | {'no' if f.always else 'yes'} |" for f in known.values()]
    return "\n".join(lines) + "\n"
