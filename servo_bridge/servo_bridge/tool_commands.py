"""Commands of ``servo-tool``: functions of an open session that return an exit status."""

from __future__ import annotations

import argparse
import csv
import fnmatch
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from servo_msgs_py.board_description import board_of
from servo_msgs_py.catalogue import Catalogue, Value, numbers
from servo_msgs_py.output_file import check_output, named, open_output, write_file
from servo_msgs_py.table_text import aligned
from servo_msgs_py.units import PERIOD_NS
from servo_msgs_py.value_text import name_text

from servo_bridge import parameter_file
from servo_bridge.freemaster.client import LEVELS
from servo_bridge.freemaster.errors import StatusError
from servo_bridge.freemaster.tsa import Number
from servo_bridge.sampler import Reading, Sampler
from servo_bridge.tool_storage import save_to_board, storage_row
from servo_bridge.tool_values import UsageError, describe, lookup, opened, parse_values, value_text
from servo_bridge.wire.board_clock import TickExtender
from servo_bridge.wire.serial_port import LowLatency
from servo_bridge.wire.session import BoardMismatchError, BoardVariable, Session
from servo_msgs_py import board_parameters

_TICK: Final = "tick"
_LOG_POLL: Final = 0.05  # [s]
_LOG_END: Final = 3  # consecutive empty responses at the end; the board fills its pipe in the background


@dataclass(frozen=True)
class Context:
    """Arguments and session of a command."""

    args: argparse.Namespace
    catalogue: Catalogue
    session: Session
    port: str
    baud: int
    low_latency: LowLatency
    release: Callable[[], None] = lambda: None  # closes the port, for another program; the session has ended then


CommandFunction = Callable[[Context], int]
Check = Callable[[argparse.Namespace], object]
"""Check of arguments and files before the port is opened; what it reads becomes an attribute of the arguments."""
Selection = list[tuple[BoardVariable, int | None]]


def info(context: Context) -> int:
    """Print the identification of the board."""
    board, session = context.session.info, context.session
    contract = "matches" if session.mismatch is None else str(session.mismatch)
    password = f"to {LEVELS[board.password_level]}" if board.password_level else "none"
    rows = [
        ("port", f"{context.port} at {context.baud} baud"),
        ("low latency", context.low_latency.text),
        ("board", f"{board.name or '(no name)'} {board.description}".rstrip()),
        ("hardware", board_of(board.name) or ""),
        ("built", board.build),
        ("driver", f"FreeMASTER v{board.protocol} {board.version}".rstrip()),
        ("buffer", f"{board.mtu} bytes"),
        ("byte order", "high byte first" if board.big_endian else "low byte first"),
        ("password", password),
        ("scopes, recorders, pipes", f"{board.scopes}, {board.recorders}, {board.pipes}"),
        *((f"recorder {index}", _recorder_text(session, index)) for index in range(board.recorders)),
        ("variables", str(len(session.variables))),
        ("catalogue", contract),
        storage_row(context),
    ]
    rows += [
        (name, value_text(session.variables[name], session.read(session.variables[name]), context.catalogue))
        for name in session.variables
        if session.mismatch is None
        and name.rpartition(".")[2] in ("state", "substate", "faults", "winding_temperature")
    ]
    _print_columns([row for row in rows if row[1]])
    return 0


def _recorder_text(session: Session, index: int) -> str:
    """Text of the properties of a recorder, as far as reported."""
    try:
        limits = session.client.recorder(index).limits()
    except StatusError as error:
        return error.meaning
    parts = [limits.name] if limits.name else []
    if limits.memory is not None:
        parts.append(f"{limits.memory} bytes")
    if limits.period_ns:
        parts.append(f"{1e9 / limits.period_ns:g} Hz")
    return ", ".join(parts)


def list_variables(context: Context) -> int:
    """Print the variables of the board."""
    rows = describe(_matching(context, context.args.pattern), context.catalogue)
    if not rows:
        print(f"servo-tool: no variable matches {context.args.pattern!r}", file=sys.stderr)
        return 1
    warn(context)
    _print_columns([("NAME", "TYPE", "ACCESS", "UNIT", "LIMITS", "DESCRIPTION"), *rows])
    return 0


def get(context: Context) -> int:
    """Print variables once."""
    names = opened(context.session.variables, context.args.names)
    selection = select(context, names)
    warn(context)
    values = [_element(context.session.read(variable), element) for variable, element in selection]
    if context.args.json:
        plain = (v.hex() if isinstance(v, bytes) else v for v in values)
        print(json.dumps(dict(zip(names, plain, strict=True))))
        return 0
    texts = [value_text(v, value, context.catalogue) for (v, _), value in zip(selection, values, strict=True)]
    _print_columns([(name, "=", text) for name, text in zip(names, texts, strict=True)])
    return 0


def set_variable(context: Context) -> int:
    """Write one variable and read it back."""
    args = context.args
    ((variable, element),) = select(context, [args.name])
    _require_contract(context)
    if args.element is not None:
        if element is not None:
            raise UsageError(f"{args.name} already has an element")
        if not 0 <= args.element < variable.count:
            raise UsageError(f"{variable.name} has elements 0 .. {variable.count - 1}")
        element = args.element
    values = parse_values(variable, args.value, context.catalogue)
    expected = variable.count if element is None else 1
    if len(values) != expected:
        hint = "; write all of them with commas, or one with --element K" if expected > 1 else ""
        raise UsageError(f"{args.name}: {len(values)} value(s) given, {expected} expected{hint}")
    try:
        data = variable.encode(values, element or 0)[1]
    except ValueError as error:
        raise UsageError(str(error)) from None
    _refuse_contradictions(context, {variable.name: (element or 0, data)})
    before = context.session.read(variable)
    context.session.write(variable, values, element or 0)
    after = context.session.read(variable)
    old, new = (value_text(variable, _element(v, element), context.catalogue) for v in (before, after))
    print(f"{args.name} = {new} (was {old})")
    stored = variable.encode(numbers(after)[element or 0 :][: len(values)], element or 0)[1]
    if variable.name.startswith(board_parameters.PREFIX) and stored != data:  # the board itself changes commands
        print(f"servo-tool: the board has another value of {args.name} than the written one", file=sys.stderr)
        return 1
    return 0


def watch(context: Context) -> int:
    """Print variables periodically."""
    names = opened(context.session.variables, context.args.names)
    selection = select(context, names)
    warn(context)
    sampler = Sampler(context.session, [variable for variable, _ in selection])
    start = time.monotonic_ns()
    lines = 0
    try:
        for reading in _readings(sampler, context.args.rate, None):
            texts = (
                f"{name}={value_text(v, _element(value, k), context.catalogue)}"
                for name, (v, k), value in zip(names, selection, reading.values, strict=True)
            )
            print(f"{(reading.time_ns - start) * 1e-9:9.3f}  " + "  ".join(texts), flush=True)
            lines += 1
            if lines == context.args.count:
                break
    except KeyboardInterrupt:
        pass
    return 0


def record(context: Context) -> int:
    """Write variables to a CSV file."""
    names = opened(context.session.variables, context.args.names)
    selection = select(context, names)
    warn(context)
    tick = context.session.variables.get(_TICK) if context.session.mismatch is None else None
    variables = [variable for variable, _ in selection]
    for variable in variables:
        if variable.is_block:
            raise UsageError(f"{variable.name} is a block of bytes; write the variables in it")
    sampler = Sampler(context.session, [tick, *variables] if tick is not None else variables)
    extender = TickExtender()
    rows = 0
    first = last = None
    started = time.monotonic()
    (output,) = context.args.output
    with named(output), open_output(output, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        heads = [head for (v, k), name in zip(selection, names, strict=True) for head in _heads(v, k, name)]
        writer.writerow(["time [s]", *(["tick"] if tick is not None else []), *heads])
        try:
            for reading in _readings(sampler, context.args.rate, context.args.duration):
                values = list(reading.values)
                moment, head = reading.time_ns, []
                if tick is not None:
                    count = extender.update(int(numbers(values.pop(0))[0]), reading.time_ns, reading.time_ns).tick
                    if count == last:
                        continue  # same sample as before
                    moment, head, last = count * PERIOD_NS, [count], count
                first = moment if first is None else first
                cells = [n for (_, k), v in zip(selection, values, strict=True) for n in numbers(_element(v, k))]
                writer.writerow([f"{(moment - first) * 1e-9:.7f}", *head, *cells])
                rows += 1
        except KeyboardInterrupt:
            pass
    seconds = max(time.monotonic() - started, 1e-9)
    note = "" if sampler.simultaneous else "; too many for the scope of the board, so each was read separately"
    print(f"{rows} rows in {seconds:.1f} s ({rows / seconds:.0f}/s) in {output}{note}")
    return 0


def check_save(args: argparse.Namespace) -> None:
    if args.to_board == bool(args.file):
        raise UsageError(
            "write a FILE for the parameters, or --to-board to store parameters and configuration on the board"
        )
    if args.file:
        check_output(parameter_file.checked(args.file))


def save(context: Context) -> int:
    """Save parameters."""
    if context.args.to_board:
        return save_to_board(context)
    variables = context.session.variables
    names = opened(variables, (v.name for v in _matching(context, context.args.match)))
    chosen = [v for v in map(variables.__getitem__, names) if v.target.writable and not v.is_block]
    if not chosen:
        print(f"servo-tool: no writable variable matches {context.args.match!r}", file=sys.stderr)
        return 1
    warn(context)
    path: Path = context.args.file
    parameters = {v.name: _named(v, context.session.read(v), context.catalogue) for v in chosen}
    known = context.catalogue.hash if context.session.mismatch is None else None
    text = parameter_file.dump(path, parameters, {v.name: v.unit for v in chosen}, known)
    write_file(path, text)
    print(f"{len(parameters)} parameters in {path}")
    return 0


def check_file(args: argparse.Namespace) -> None:
    parameter_file.load(parameter_file.checked(args.file), None)


def load(context: Context) -> int:
    """Write the parameters of a file that differ from the board; all are checked before the first write."""
    _require_contract(context)
    session = context.session
    target, found = _compare(context)
    _refuse_contradictions(context, {name: (0, data) for name, data in target.items()})
    names = parameter_file.changes(session.variables, target, found)
    for name in names:
        variable = session.variables[name]
        session.write_bytes(variable, target[name])
        now = session.client.read_memory(variable.address, variable.size)
        print(_change_text(context, variable, found[name], now))
        if now != target[name]:
            print(f"servo-tool: the board has another value of {name} than the file", file=sys.stderr)
            return 1
    print(f"{len(names)} of {len(target)} parameters changed")
    return 0


def diff(context: Context) -> int:
    """Print the parameters that differ between board and file."""
    target, found = _compare(context)
    names = parameter_file.changes(context.session.variables, target, found)
    for name in names:
        print(_change_text(context, context.session.variables[name], found[name], target[name]))
    print(f"{len(names)} of {len(target)} parameters differ")
    return 1 if names else 0


def log(context: Context) -> int:
    """Print the text of a pipe of the board."""
    pipe = context.session.client.pipe(context.args.pipe)
    empty = 0
    try:
        while context.args.follow or empty < _LOG_END:
            text, _ = pipe.exchange()
            print(text.decode("utf-8", "replace"), end="", flush=True)
            empty = 0 if text else empty + 1
            if empty:
                time.sleep(_LOG_POLL)
    except KeyboardInterrupt:
        pass
    except StatusError as error:
        pipes = context.session.info.pipes
        print(
            f"servo-tool: pipe {context.args.pipe}: {error.meaning}; the board reports {pipes} pipes", file=sys.stderr
        )
        return 1
    return 0


# ---- shared -------------------------------------------------------------------------------------------------------
def _matching(context: Context, pattern: str) -> list[BoardVariable]:
    return [v for name, v in context.session.variables.items() if fnmatch.fnmatchcase(name, pattern)]


def select(context: Context, names: Sequence[str]) -> Selection:
    """Find the named variables; with ``--raw`` without scaling."""
    found = [lookup(context.session.variables, name) for name in names]
    if getattr(context.args, "raw", False):
        return [(replace(variable, contract=None), element) for variable, element in found]
    return found


def warn(context: Context) -> None:
    """Print a warning if numbers are raw because the board does not have this contract."""
    if context.session.mismatch is not None:
        print(f"servo-tool: values are not scaled: {context.session.mismatch.reason}", file=sys.stderr)


def _require_contract(context: Context) -> None:
    """Refuse writes to a servo board of another version; other FreeMASTER targets are written by their own types."""
    mismatch = context.session.mismatch
    if isinstance(mismatch, BoardMismatchError) and not mismatch.foreign and not getattr(context.args, "raw", False):
        raise mismatch


def _element(value: Value, element: int | None) -> Value:
    return value[element] if element is not None and isinstance(value, list) else value


def _heads(variable: BoardVariable, element: int | None, name: str) -> list[str]:
    unit = f" [{variable.unit}]" if variable.unit else ""
    count = variable.count if element is None else 1
    return [f"{name}{f'[{k}]' if count > 1 else ''}{unit}" for k in range(count)]


def _readings(sampler: Sampler, rate: float | None, duration: float | None) -> Iterator[Reading]:
    """Readings at a rate, or as fast as possible."""
    period = 0.0 if rate is None else 1.0 / rate
    start = due = time.monotonic()
    while duration is None or time.monotonic() - start < duration:
        yield sampler.read()
        due = max(due + period, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))


def _compare(context: Context) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Bytes of the file and bytes of the board, by parameter."""
    path = parameter_file.checked(Path(context.args.file))
    variables, catalogue = context.session.variables, context.catalogue
    known = catalogue.hash if context.session.mismatch is None else None
    parameters = parameter_file.load(path, known)
    target = parameter_file.to_bytes(variables, parameters, catalogue)
    client = context.session.client
    return target, {name: client.read_memory(variables[name].address, variables[name].size) for name in target}


def _refuse_contradictions(context: Context, writes: Mapping[str, tuple[int, bytes]]) -> None:
    """Refuse parameters that contradict each other or those of the board.

    Parameters
    ----------
    context : Context
        The board.
    writes : mapping
        First element and bytes, by name.

    Raises
    ------
    UsageError
        If parameters contradict each other, with the reason.
    """
    session = context.session
    if session.mismatch is not None or not board_parameters.COMPARED.intersection(writes):
        return
    values: dict[str, list[int]] = {}
    for name in board_parameters.COMPARED:
        variable, contract = session.variables[name], context.catalogue[name]
        stored = bytearray(session.client.read_memory(variable.address, variable.size))
        if name in writes:
            first, data = writes[name]
            begin = first * contract.element_size
            stored[begin : begin + len(data)] = data
        values[name] = contract.decode_raw(bytes(stored))
    problem = board_parameters.contradiction(values, context.catalogue)
    if problem:
        raise UsageError(problem)


def _named(variable: BoardVariable, value: Value, catalogue: Catalogue) -> list[Number | str]:
    """Numbers of a value, as names where they have one."""
    contract = variable.contract
    if contract is None:
        return list(numbers(value))
    return [name_text(contract, number, catalogue) or number for number in numbers(value)]


def _change_text(context: Context, variable: BoardVariable, old: bytes, new: bytes) -> str:
    texts = [value_text(variable, variable.decode(data), context.catalogue) for data in (old, new)]
    return f"{variable.name}: {texts[0]} -> {texts[1]}"


def _print_columns(rows: Sequence[Sequence[str]]) -> None:
    for line in aligned(rows):
        print(line)
