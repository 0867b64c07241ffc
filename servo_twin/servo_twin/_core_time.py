"""Instruments C sources with their execution time, for the virtual core.

A file is read by the preprocessor of the compiler and by pycparser; a call ``core_spend(n)`` is inserted before each
statement and each conditionally executed operand (``native/chip/core_time.h``). The cost table below is in instructions
of a Cortex-M3; a factor per file, calibrated with counted instructions (``core_weights.toml``), accounts for the code
of a real compiler. The time of the virtual core therefore depends on the source alone, not on the compiler of the host.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pycparser import c_ast, c_generator, c_parser

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

UNITS: Final = 16
"""Units of time per instruction."""

COMMON: Final = "common"
WEIGHTS: Final = Path(__file__).with_name("core_weights.toml")

_VERSION: Final = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()

# Replacement of the system headers of the host: the parser does not support compiler extensions.
_HEADERS: Final = {
    "stdint.h": """\
typedef signed char int8_t; typedef unsigned char uint8_t; typedef short int16_t; typedef unsigned short uint16_t;
typedef int int32_t; typedef unsigned int uint32_t; typedef long int64_t; typedef unsigned long uint64_t;
typedef unsigned long uintptr_t; typedef unsigned long uintmax_t;
#define INT8_MAX 127
#define INT8_MIN (-128)
#define UINT8_MAX 255
#define INT16_MAX 32767
#define INT16_MIN (-32768)
#define UINT16_MAX 65535
#define INT32_MAX 2147483647
#define INT32_MIN (-2147483647 - 1)
#define UINT32_MAX 4294967295U
#define INT64_MAX 9223372036854775807L
#define INT64_MIN (-9223372036854775807L - 1)
#define UINT64_MAX 18446744073709551615UL
#define INT8_C(x) x
#define UINT8_C(x) x
#define INT16_C(x) x
#define UINT16_C(x) x
#define INT32_C(x) x
#define UINT32_C(x) x##U
#define INT64_C(x) x##L
#define UINT64_C(x) x##UL
""",
    "stdbool.h": "#define bool _Bool\n#define true 1\n#define false 0\n",
    "stddef.h": """\
#ifndef STDDEF_H
#define STDDEF_H
typedef unsigned long size_t;
#define NULL ((void *)0)
#define offsetof(type, member) ((size_t)&((type *)0)->member)
#endif
""",
    "string.h": """\
#include <stddef.h>
void *memcpy(void *, const void *, size_t); void *memmove(void *, const void *, size_t);
void *memset(void *, int, size_t); int memcmp(const void *, const void *, size_t);
""",
    "stdlib.h": "#include <stddef.h>\nvoid *calloc(size_t, size_t); void free(void *);\n",
    "math.h": "",
    # Their contents are those of a machine: no image of a board contains them.
    "setjmp.h": "typedef struct { int opaque; } jmp_buf[1];\n",
    "ucontext.h": "typedef struct { int opaque; } ucontext_t;\n",
}

# ---- cost table: instructions of a Cortex-M3 -------------------------------------------------------------------------

_ACCESS = 1.0  # a load or a store
_CALL = 4.0  # function that is not inlined: branch, saving and restoring of registers, return
_ARGUMENT = 1.0
_BRANCH = 1.0
_LONG: Final = {"*": 4.0, "/": 60.0, "%": 60.0, "<<": 3.0, ">>": 3.0}  # 64-bit operations; others take 2
_SHORT: Final = {"/": 2.0, "%": 3.0}  # 32-bit operations; others take 1
_CHEAP: Final = 1.5  # a conditional operand up to this cost is included in the statement
_CHIP: Final = {"chip_read": 2.0, "chip_write": 2.0}  # access and address calculation on silicon
_INSTRUCTIONS: Final = {"asr16": 1.0, "asr32": 1.0, "asr64": 3.0, "sat16": 1.0, "sat16_asr": 1.0, "sat32": 3.0}
"""Functions that compile to one or a few instructions (math/saturate.h, math/frac.h)."""


class _Names(c_ast.NodeVisitor):
    """Names that determine costs."""

    def __init__(self) -> None:
        self.long_types: set[str] = {"int64_t", "uint64_t"}  # 64-bit types
        self.long: set[str] = set()  # variables, members and functions of 64-bit types, in any scope
        self.inline: set[str] = set()  # functions that the compiler inlines
        self.prices: dict[str, float] = {**_CHIP, **_INSTRUCTIONS}  # total cost per call, by function

    def is_long(self, declared: Any) -> bool:
        return isinstance(declared.type, c_ast.IdentifierType) and bool(self.long_types & set(declared.type.names))

    def visit_Typedef(self, node: Any) -> None:
        if isinstance(node.type, c_ast.TypeDecl) and self.is_long(node.type):
            self.long_types.add(node.name)
        self.generic_visit(node)

    def visit_Decl(self, node: Any) -> None:
        kind = node.type
        while isinstance(kind, (c_ast.FuncDecl, c_ast.ArrayDecl)):
            kind = kind.type
        if isinstance(kind, c_ast.TypeDecl) and self.is_long(kind) and node.name is not None:
            self.long.add(node.name)
        self.generic_visit(node)

    def visit_FuncDef(self, node: Any) -> None:
        if "static" in node.decl.storage:
            self.inline.add(node.decl.name)
        self.generic_visit(node)


class _Charger:
    """Calculates costs of expressions and inserts the calls of ``core_spend``.

    Parameters
    ----------
    names : _Names
    charge : callable
        Node of a call of ``core_spend`` for a number of instructions.
    """

    def __init__(self, names: _Names, charge: Callable[[float], Any]) -> None:
        self._names = names
        self._charge = charge
        self._flat = False

    # -- expressions --

    def _long(self, node: Any) -> bool:
        """True if an expression has 64 bits."""
        if isinstance(node, c_ast.Cast):
            return isinstance(node.to_type.type, c_ast.TypeDecl) and self._names.is_long(node.to_type.type)
        if isinstance(node, c_ast.BinaryOp):
            if node.op in ("<<", ">>"):
                return self._long(node.left)
            return node.op in ("*", "/", "%", "+", "-", "&", "|", "^") and (
                self._long(node.left) or self._long(node.right)
            )
        if isinstance(node, c_ast.UnaryOp):
            return node.op in ("-", "~", "+", "*") and self._long(node.expr)
        if isinstance(node, c_ast.TernaryOp):
            return self._long(node.iftrue) or self._long(node.iffalse)
        if isinstance(node, c_ast.ID):
            return node.name in self._names.long
        if isinstance(node, c_ast.StructRef):
            return node.field.name in self._names.long
        if isinstance(node, c_ast.ArrayRef):
            return self._long(node.name)
        if isinstance(node, c_ast.FuncCall):
            return self._long(node.name)
        if isinstance(node, c_ast.Assignment):
            return self._long(node.lvalue)
        return False

    def _guard(self, node: Any) -> tuple[float, Any]:
        """Cost and replacement of a conditional operand."""
        price = self.price(node)
        if self._flat or (price <= _CHEAP and not self._calls(node)):
            return 0.5 * price, node
        return 0.0, c_ast.ExprList([self._charge(price), node])

    def _address(self, node: Any) -> float:
        """Cost of calculating the address of an lvalue, including the loads for it."""
        while isinstance(node, (c_ast.StructRef, c_ast.ArrayRef)):
            if isinstance(node, c_ast.ArrayRef):
                return self.price(node.subscript) + self._address(node.name)
            if node.type == "->":
                return self.price(node.name)
            node = node.name
        if isinstance(node, c_ast.UnaryOp) and node.op == "*":
            return self.price(node.expr)
        return 0.0 if isinstance(node, c_ast.ID) else self.price(node)

    def price(self, node: Any) -> float:
        """Instructions of an expression; conditional operands get separate calls."""
        if node is None or isinstance(node, (c_ast.Constant, c_ast.ID)):
            return 0.0
        if isinstance(node, (c_ast.StructRef, c_ast.ArrayRef)):
            return _ACCESS * (2.0 if self._long(node) else 1.0) + self._address(node)
        if isinstance(node, c_ast.Cast):
            return self.price(node.expr)
        if isinstance(node, c_ast.UnaryOp):
            if node.op == "&":
                return self._address(node.expr)
            if node.op == "sizeof":
                return 0.0
            if node.op == "*":
                return _ACCESS + self.price(node.expr)
            store = _ACCESS if node.op in ("++", "--", "p++", "p--") and _in_memory(node.expr) else 0.0
            return 1.0 + store + self.price(node.expr)
        if isinstance(node, c_ast.BinaryOp):
            return self._binary(node)
        if isinstance(node, c_ast.TernaryOp):
            price = self.price(node.cond) + _BRANCH
            yes, node.iftrue = self._guard(node.iftrue)
            no, node.iffalse = self._guard(node.iffalse)
            return price + yes + no
        if isinstance(node, c_ast.Assignment):
            return self._assignment(node)
        if isinstance(node, c_ast.FuncCall):
            return self._call(node)
        if isinstance(node, c_ast.ExprList):
            return sum(self.price(each) for each in node.exprs)
        if isinstance(node, (c_ast.InitList, c_ast.CompoundLiteral)):
            inner = node.init.exprs if isinstance(node, c_ast.CompoundLiteral) else node.exprs
            return sum(0.5 * _ACCESS + self.price(each) for each in inner)
        if isinstance(node, c_ast.NamedInitializer):
            return self.price(node.expr)
        raise TypeError(f"{node.coord}: the price list has no {type(node).__name__}")

    def _binary(self, node: Any) -> float:
        left = self.price(node.left)
        if node.op in ("&&", "||"):
            right, node.right = self._guard(node.right)
            return left + right + _BRANCH
        both = left + self.price(node.right)
        if isinstance(node.left, c_ast.Constant) and isinstance(node.right, c_ast.Constant):
            return both
        if self._long(node.left) or (self._long(node.right) and node.op not in ("<<", ">>")):
            narrow = node.op == "*" and not (_wide(node.left) and _wide(node.right))
            return both + (2.0 if narrow else _LONG.get(node.op, 2.0))
        return both + _SHORT.get(node.op, 1.0)

    def _assignment(self, node: Any) -> float:
        store = (_ACCESS + self._address(node.lvalue)) if _in_memory(node.lvalue) else 0.5
        if node.op == "=":
            return store + self.price(node.rvalue)
        operation = c_ast.BinaryOp(node.op[:-1], node.lvalue, node.rvalue)
        price = store + self._binary(operation)
        node.rvalue = operation.right
        return price

    def _call(self, node: Any) -> float:
        arguments = node.args.exprs if node.args is not None else []
        price = sum(self.price(each) for each in arguments)
        name = node.name.name if isinstance(node.name, c_ast.ID) else ""
        if name in self._names.prices:
            return price + self._names.prices[name]
        if name in self._names.inline:
            return price
        return price + self.price(node.name) + _CALL + _ARGUMENT * len(arguments)

    def _calls(self, node: Any) -> bool:
        """True if there is a call of a function with unknown cost."""
        if isinstance(node, c_ast.FuncCall) and not (
            isinstance(node.name, c_ast.ID) and node.name.name in self._names.prices
        ):
            return True
        return any(self._calls(child) for _, child in node.children())

    # -- statements --

    def whole(self, function: Any) -> float | None:
        """Cost of a small inline function, with the mean of two branches; None if it has loops or other calls."""
        if _loops(function.body) or self._calls(function.body):
            return None
        self._flat = True
        price = self._sum(function.body)
        self._flat = False
        return price

    def _sum(self, node: Any) -> float:
        if node is None:
            return 0.0
        if isinstance(node, c_ast.Compound):
            return sum(self._sum(item) for item in node.block_items or [])
        if isinstance(node, c_ast.If):
            return self.price(node.cond) + _BRANCH + 0.5 * (self._sum(node.iftrue) + self._sum(node.iffalse))
        return self._statement(node)

    def body(self, node: Any) -> Any:
        """Statement as a compound statement with calls of ``core_spend``."""
        items = node.block_items if isinstance(node, c_ast.Compound) else [node]
        return c_ast.Compound(self._items(items or []))

    def _items(self, items: Sequence[Any]) -> list[Any]:
        result: list[Any] = []
        for item in items:
            price = self._statement(item)
            if price >= 0.5:
                result.append(self._charge(price))
            result.append(item)
        return result

    def _statement(self, node: Any) -> float:
        """Cost of a statement up to its first branch; nested statements get separate calls."""
        if isinstance(node, c_ast.Decl):
            if node.init is None or "static" in node.storage:
                return 0.0
            return self.price(node.init) + 0.25
        if isinstance(node, c_ast.DeclList):
            return sum(self._statement(each) for each in node.decls)
        if isinstance(node, c_ast.If):
            price = self.price(node.cond) + _BRANCH
            node.iftrue = self.body(node.iftrue)
            if node.iffalse is not None:
                node.iffalse = self.body(node.iffalse)
            return price
        if isinstance(node, (c_ast.For, c_ast.While, c_ast.DoWhile)):
            return self._loop(node)
        if isinstance(node, c_ast.Switch):
            self._cases(node.stmt)
            return self.price(node.cond) + 3.0 * _BRANCH
        if isinstance(node, c_ast.Compound):
            node.block_items = self._items(node.block_items or [])
            return 0.0
        if isinstance(node, c_ast.Return):
            return self.price(node.expr)
        if isinstance(node, (c_ast.Break, c_ast.Continue, c_ast.EmptyStatement, c_ast.Goto)):
            return 0.0
        return self.price(node)

    def _loop(self, node: Any) -> float:
        first = 0.0
        if isinstance(node, c_ast.For) and node.init is not None:
            first = self._statement(node.init) if isinstance(node.init, c_ast.DeclList) else self.price(node.init)
        iteration = self.price(node.cond) + _BRANCH
        if isinstance(node, c_ast.For):
            iteration += self.price(node.next)
        node.stmt = self.body(node.stmt)
        node.stmt.block_items.insert(0, self._charge(iteration))
        return first + (0.0 if isinstance(node, c_ast.DoWhile) else _BRANCH)

    def _cases(self, node: Any) -> None:
        for item in node.block_items or []:
            if isinstance(item, (c_ast.Case, c_ast.Default)):
                item.stmts = self._items(item.stmts or [])


def _loops(node: Any) -> bool:
    kinds = (c_ast.For, c_ast.While, c_ast.DoWhile, c_ast.Switch)
    return isinstance(node, kinds) or any(_loops(child) for _, child in node.children())


def _in_memory(node: Any) -> bool:
    return isinstance(node, (c_ast.StructRef, c_ast.ArrayRef)) or (isinstance(node, c_ast.UnaryOp) and node.op == "*")


def _wide(node: Any) -> bool:
    """True if a factor is not just a widened 32-bit value."""
    return not isinstance(node, (c_ast.Cast, c_ast.ID, c_ast.StructRef, c_ast.Constant))


# ---- files -----------------------------------------------------------------------------------------------------------


def charged(text: str, name: str, charge: Callable[[float], str]) -> str:
    """Insert calls of ``core_spend`` into a preprocessed C file.

    Parameters
    ----------
    text : str
        Output of the preprocessor, with the headers above.
    name : str
        File name in error messages.
    charge : callable
        Text of the inserted call for a cost in instructions.

    Raises
    ------
    pycparser.plyparser.ParseError
        If the file is not C99.
    """
    tree = c_parser.CParser().parse(text, name)
    names = _Names()
    names.visit(tree)
    charger = _Charger(names, lambda price: c_ast.ID(charge(price)))
    for node in tree.ext:
        if isinstance(node, c_ast.FuncDef) and node.decl.name not in names.prices:
            price = charger.whole(node) if "inline" in node.decl.funcspec else None
            if price is not None:
                names.prices[node.decl.name] = price
                continue
            node.body = charger.body(node.body)
            if node.decl.name not in names.inline:
                node.body.block_items.insert(0, c_ast.ID(charge(_CALL)))
    return str(c_generator.CGenerator().visit(tree))


_COMPILER: Final = ("cc", "-std=c99", "-E", "-P", "-U__GNUC__", "-nostdinc")


def load_weights(path: Path = WEIGHTS) -> dict[str, float]:
    """Factor of each file, by folder and stem as in ``control/pi``; `COMMON` for all others."""
    with path.open("rb") as file:
        table = tomllib.load(file)
    return {COMMON: float(table[COMMON]), **{name: float(value) for name, value in table["weights"].items()}}


def weight_of(weights: Mapping[str, float], name: str) -> float:
    """Factor of one file."""
    return weights.get(name, weights[COMMON])


def preprocessed(source: Path, include: Iterable[Path], options: Iterable[str] = ()) -> str:
    """Preprocessed C file without directives.

    Raises
    ------
    RuntimeError
        If the preprocessor reports an error.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name, text in _HEADERS.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        paths = [f"-I{folder}", *(f"-I{path}" for path in include)]
        done = subprocess.run([*_COMPILER, *paths, *options, source], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{source}: {done.stderr.strip()}")
    return done.stdout


_PARALLEL_MIN: Final = 10
"""Smallest number of files for parallel processes; a file takes 0.1 s."""


def _spend(factor: float) -> Callable[[float], str]:
    return lambda price: f"core_spend({round(UNITS * factor * price)})"


@dataclass(frozen=True)
class _Stale:
    """A file that must be instrumented again."""

    source: Path  # the file
    output: Path  # instrumented file
    head: str  # first line of the instrumented file
    text: str  # preprocessed file
    factor: float  # weight of the file

    def write(self) -> None:
        """Instrument the file and replace the old output."""
        body = charged(self.text, str(self.source), _spend(self.factor))
        self.output.parent.mkdir(parents=True, exist_ok=True)
        # Flag 3 (system header) disables warnings in the generated code. The text is the same in every checkout.
        name = "/".join(self.source.parts[-2:])
        complete = self.output.with_suffix(f".{os.getpid()}")  # another process may be writing the same
        complete.write_text(f'{self.head}\n#include "chip/core_time.h"\n# 1 "{name}" 3\n{body}', encoding="utf-8")
        complete.replace(self.output)


def write_charged(sources: Iterable[Path], firmware: Path, options: Sequence[str], folder: Path) -> list[Path]:
    """Write instrumented files of the firmware, one process per processor; unchanged files are not rewritten.

    Parameters
    ----------
    sources : iterable of Path
        C files below `firmware`.
    firmware : Path
        Include folder.
    options : sequence of str
        Options of the preprocessor.
    folder : Path
        Output folder; subfolders as in `firmware`.

    Returns
    -------
    list of Path
        In the order of `sources`.
    """
    weights = load_weights()
    sources = list(sources)
    written = [folder / source.parent.name / source.name for source in sources]
    inputs, stamp = _digest_of_inputs(sources, firmware, options), folder / "inputs"
    if stamp.is_file() and stamp.read_text(encoding="ascii") == inputs and all(map(Path.is_file, written)):
        return written  # setup.py asks several times in one build; the preprocessor would take 1.5 s each time
    stale: list[_Stale] = []
    for source, output in zip(sources, written, strict=True):
        factor = weight_of(weights, f"{source.parent.name}/{source.stem}")
        text = preprocessed(source, [firmware], options)
        head = f"/* {hashlib.sha256(f'{_VERSION}{factor}{text}'.encode()).hexdigest()} */"
        if not output.is_file() or output.open(encoding="utf-8").readline().rstrip() != head:
            stale.append(_Stale(source, output, head, text, factor))
    if len(stale) < _PARALLEL_MIN:
        for one in stale:
            one.write()
    else:
        # A forked process does not import setup.py again.
        with ProcessPoolExecutor(mp_context=multiprocessing.get_context("fork")) as pool:
            list(pool.map(_Stale.write, stale))
    stamp.write_text(inputs, encoding="ascii")
    return written


def _digest_of_inputs(sources: Iterable[Path], firmware: Path, options: Sequence[str]) -> str:
    """Digest of the C files, the headers and the weights, which determine the instrumented files with one compiler."""
    digest = hashlib.sha256(f"{_VERSION}{options}".encode())
    for path in (WEIGHTS, *sources, *sorted(firmware.rglob("*.h"))):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    return digest.hexdigest()
