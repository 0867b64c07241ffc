"""Finds every pointer in the C structure of a virtual board, so that its state can be copied to another address.

The list comes from the declarations themselves: it contains a new member of the firmware or of a model without further
work.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pycparser import c_ast, c_parser

from servo_twin._core_time import preprocessed


class _Types(c_ast.NodeVisitor):
    """Types and enumerators of a file."""

    def __init__(self) -> None:
        self.typedefs: dict[str, Any] = {}
        self.structs: dict[str, Any] = {}
        self.enumerators: dict[str, int] = {}

    def visit_Typedef(self, node: Any) -> None:
        self.typedefs[node.name] = node.type
        self.generic_visit(node)

    def visit_Struct(self, node: Any) -> None:
        if node.name is not None and node.decls is not None:
            self.structs[node.name] = node
        self.generic_visit(node)

    def visit_EnumeratorList(self, node: Any) -> None:
        value = -1
        for enumerator in node.enumerators:
            value = value + 1 if enumerator.value is None else self.number(enumerator.value)
            self.enumerators[enumerator.name] = value

    def number(self, node: Any) -> int:
        """Value of a constant expression."""
        match node:
            case c_ast.Constant():
                return int(node.value.rstrip("uUlL"), 0)
            case c_ast.ID():
                return self.enumerators[node.name]
            case c_ast.UnaryOp(op="-"):
                return -self.number(node.expr)
            case c_ast.Cast():
                return self.number(node.expr)
            case c_ast.BinaryOp(op="+"):
                return self.number(node.left) + self.number(node.right)
            case c_ast.BinaryOp(op="-"):
                return self.number(node.left) - self.number(node.right)
            case c_ast.BinaryOp(op="*"):
                return self.number(node.left) * self.number(node.right)
            case c_ast.BinaryOp(op="/"):
                return self.number(node.left) // self.number(node.right)
        raise ValueError(f"{node.coord}: this expression is not supported as size of an array that contains pointers")

    def pointers(self, kind: Any) -> Iterator[str]:
        """Places of the pointers in an object, as they follow its name: ``.axis[1].hal``."""
        match kind:
            case c_ast.PtrDecl():
                yield ""
            case c_ast.TypeDecl():
                yield from self.pointers(kind.type)
            case c_ast.IdentifierType() if kind.names[-1] in self.typedefs:
                yield from self.pointers(self.typedefs[kind.names[-1]])
            case c_ast.ArrayDecl():
                if places := list(self.pointers(kind.type)):
                    yield from (f"[{k}]{place}" for k in range(self.number(kind.dim)) for place in places)
            case c_ast.Struct() | c_ast.Union():
                for member in (self.structs[kind.name] if kind.name else kind).decls:
                    for place in self.pointers(member.type):
                        if isinstance(kind, c_ast.Union):
                            raise ValueError(f"{kind.coord}: a union hides its pointer {member.name}; use a structure")
                        yield f".{member.name}{place}"


def write_pointers(source: Path, include: Sequence[Path], options: Sequence[str], build: str, folder: Path) -> Path:
    """Write ``board_pointers.h``, unless it is up to date, for a file with ``struct board``.

    Parameters
    ----------
    source : Path
        The file, which includes ``board_pointers.h``.
    include : sequence of Path
        Include folders.
    options : sequence of str
        Options of the preprocessor.
    build : str
        Identity of the build, 16 hexadecimal digits.
    folder : Path
        Folder of the header.

    Returns
    -------
    Path
        The header.
    """
    header = folder / "board_pointers.h"
    constant = f"#define BOARD_BUILD UINT64_C(0x{build}) /* sources, options and compiler */\n"
    if header.is_file() and constant in header.read_text(encoding="ascii"):
        return header
    header.parent.mkdir(parents=True, exist_ok=True)
    header.touch()  # the file includes it
    types = _Types()
    text = preprocessed(source, [*include, header.parent], options)
    types.visit(c_parser.CParser().parse(text, str(source)))
    places = types.pointers(types.structs["board"])
    lines = "".join(f"    offsetof(struct board, {place[1:]}),\n" for place in places)
    text = (
        "/* Written by _board_pointers.py: every pointer in struct board. */\n"
        f"static const size_t board_pointers[] = {{\n{lines}}};\n{constant}"
    )
    complete = header.with_suffix(f".{os.getpid()}")  # another process may be writing the same
    complete.write_text(text, encoding="ascii")
    complete.replace(header)
    return header
