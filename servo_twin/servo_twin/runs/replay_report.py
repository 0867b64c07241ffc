"""Result of a replay as a line, as text, and as JSON."""

from __future__ import annotations

from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.table_text import aligned
from servo_msgs_py.units import PERIOD_NS

from servo_twin.diagnosis.report import change_text, estimate_numbers, estimate_text
from servo_twin.runs.divergence import Departure, Estimates
from servo_twin.runs.replay import Explained, Replayed, at

_ROWS: Final = 12  # variables in the table
_SUSPECTS: Final = {None: "configuration, parameter or firmware", "": "configuration or parameter"}
"""What may differ in the controller, by `Replayed.other_build`."""


def verdict(replayed: Replayed) -> str:
    """What became of the run, in one line."""
    return f"another build; {_outcome(replayed)}" if replayed.other_build else _outcome(replayed)


def _outcome(replayed: Replayed) -> str:
    how = "bit for bit" if all(stretch.exact for stretch in replayed.stretches) else "within noise"
    if not replayed.stretches:
        return "nothing was compared"
    if replayed.first is None:
        part = "" if replayed.compared == replayed.samples else f" of {replayed.samples}"
        return f"identical {how} over {replayed.seconds:.1f} s, {replayed.compared}{part} samples"
    since = min([replayed.first, *(one.finding.since for one in replayed.findings if not replayed.first_exact)])
    before = "bit for bit" if replayed.first_exact else "within noise"
    what = [_what(replayed.departures[0])] if replayed.departures else []
    return f"from {at(since)}: {', '.join([*what, _cause(replayed)])}; before it identical {before}"


def _what(first: Departure) -> str:
    """First variable that left the band, and how."""
    if first.left is None:
        return f"{first.variable} differs by {_size(first.largest, first)}, within the noise of a healthy pair"
    axis, _, name = first.variable.partition(".")
    more = first.value * first.first > 0.0
    if name == "speed":
        return f"{axis} speed {'runs ahead' if more else 'falls behind'} by {_size(abs(first.first), first)}"
    return f"magnitude of {first.variable} is {_size(abs(first.first), first)} too {'large' if more else 'small'}"


def _size(value: float, of: Departure) -> str:
    return f"{value:.3g} {of.unit}".rstrip()


def _cause(replayed: Replayed) -> str:
    if (fault := replayed.early_fault) is not None:
        names = ", ".join(flag.name for flag in Catalogue.load().active("faults", int(fault.value))) or "of the twin"
        return f"fault {names} of {replayed.first_axis} at {at(fault.tick)}, too early to estimate the plant"
    if not replayed.findings:
        return f"no change of the plant explains it{_suspect(replayed)}"
    return "; ".join(
        f"{'bus' if one.axis is None else axis_name(one.axis)} {change_text(one.finding)}" for one in replayed.findings
    )


def _suspect(replayed: Replayed) -> str:
    axis, explained = replayed.controller, replayed.explained
    if not axis:
        return ""
    if explained is None:
        what = _SUSPECTS.get(replayed.other_build, "firmware")
        return f": the controller of {axis} differs ({what})"
    if explained.change is None:
        return f", and no value of one member of the configuration of {axis}: several, a parameter, or the firmware"
    return f": the configuration differs, {explained.change}"


def text(replayed: Replayed) -> str:
    """Everything, with the verdict at the end."""
    lines = [f"{replayed.compared} samples compared over {replayed.seconds:.2f} s of board time"]
    lines += [
        f"  {at(one.first)} to {at(one.last)}: {one.samples} samples {'bit for bit' if one.exact else 'within noise'}"
        for one in replayed.stretches
    ]
    if replayed.departures:
        lines += ["", *aligned(_table(replayed.departures), "<>>>>>"), ""]
        shown = [key for key, one in replayed.after.items() if estimate_numbers(one)]
        rows = [["estimate", "before", "after"]]
        for key in shown:
            both = (estimate_text(those[key]) if key in those else "" for those in (replayed.before, replayed.after))
            rows.append([_name(key), *both])
        lines += aligned(rows) if shown else []
    if replayed.notes:
        lines += ["", "not as in the run:", *(f"  {note}" for note in replayed.notes)]
    return "\n".join([*lines, "", verdict(replayed)])


def _name(key: tuple[int | None, str]) -> str:
    axis, change = key
    return change if axis is None else f"{axis_name(axis)}.{change}"


def _table(departures: list[Departure]) -> list[list[str]]:
    rows = [["variable", "differs from tick", "beyond noise from", "[s]", "largest", "in noise"]]
    for one in departures[:_ROWS]:
        left = "" if one.left is None else str(one.left)
        seconds = "" if one.left is None else f"{one.left * PERIOD_NS * 1e-9:.3f}"
        ratio = f"{one.ratio:.2g}" if one.noise else ""
        rows.append([one.variable, str(one.tick), left, seconds, _size(one.largest, one), ratio])
    if len(departures) > _ROWS:
        rows.append([f"and {len(departures) - _ROWS} more", "", "", "", "", ""])
    return rows


def document(replayed: Replayed) -> dict[str, Any]:
    """Everything as JSON; times are board time since the reset [s]."""

    def estimates(those: Estimates) -> dict[str, Any]:
        return {_name(key): numbers for key, one in those.items() if (numbers := estimate_numbers(one))}

    return {
        "verdict": verdict(replayed),
        "identical": bool(replayed.stretches) and replayed.first is None,
        "first": None if replayed.first is None else _instant(replayed.first) | {"exact": replayed.first_exact},
        "compared": {"samples": replayed.compared, "seconds": replayed.seconds},
        "stretches": [
            {"from": _instant(s.first), "to": _instant(s.last), "samples": s.samples, "exact": s.exact, "end": s.end}
            for s in replayed.stretches
        ],
        "departures": [
            {
                "variable": one.variable,
                "differs": _instant(one.tick),
                "beyond_noise": None if one.left is None else _instant(one.left),
                "difference": one.first,
                "largest": one.largest,
                "noise": one.noise,
                "unit": one.unit,
            }
            for one in replayed.departures
        ],
        "before": estimates(replayed.before),
        "after": estimates(replayed.after),
        "findings": [
            {
                "axis": None if one.axis is None else axis_name(one.axis),
                "kind": one.finding.kind.value,
                "changes": list(one.finding.changes),
                "text": change_text(one.finding),
                "since": _instant(one.finding.since),
            }
            for one in replayed.findings
        ],
        "controller": replayed.controller or None,
        "configuration": _configuration(replayed.explained),
        "other_build": replayed.other_build,
        "notes": replayed.notes,
    }


def _configuration(explained: Explained | None) -> dict[str, Any] | None:
    """Member that explains the run, empty if none does; None: not known."""
    if explained is None:
        return None
    change = explained.change
    if change is None:
        return {}
    values = {"recorded": change.member.scale(change.recorded), "found": change.member.scale(change.found)}
    return {"axis": axis_name(change.axis), "member": change.member.name, **values, "unit": change.member.unit}


def _instant(tick: int) -> dict[str, float]:
    return {"tick": tick, "time": tick * PERIOD_NS * 1e-9}
