"""Declarations for cffi straight from the headers, so that a test can never assume another layout.

cffi parses C without bodies and without the system's headers. The preprocessor sees empty standard headers here, and of
an inline function only the prototype is left: ``core_inlines.c`` makes functions of them.
"""

from __future__ import annotations

import re
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from firmware_compiler import FIRMWARE, TEST

_WIDTHS = "".join(
    f"#define {sign}INT{bits}_C(x) x\n"
    f"#define {sign}INT{bits}_MAX {(1 << (bits - (sign == ''))) - 1}\n"
    f"#define {sign}INT{bits}_MIN {0 if sign else -(1 << (bits - 1))}\n"
    for sign in ("", "U")
    for bits in (8, 16, 32, 64)
)
_STANDARD = {
    "stdint.h": _WIDTHS,
    "stdbool.h": "#define bool _Bool\n#define true 1\n#define false 0\n",
    "stddef.h": "#define NULL 0\n",
    "string.h": "",
    "math.h": "",
    "setjmp.h": "typedef struct __jmp_buf_tag { ...; } jmp_buf[1];\n",
    "ucontext.h": "typedef struct ucontext_t { ...; } ucontext_t;\n",
}


def _without_bodies(text: str) -> str:
    """Leave a prototype of every inline function."""
    kept: list[str] = []
    position = 0
    for match in re.finditer(r"static inline[^;{]*\{", text):
        if match.start() < position:
            continue
        depth, end = 1, match.end()
        while depth:
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            end += 1
        prototype = match.group().removesuffix("{").rstrip()
        kept.append(text[position : match.start()] + prototype.removeprefix("static inline ") + ";")
        position = end
    return "".join(kept) + text[position:]


def _without_choices(text: str) -> str:
    """Work out ``(a < b ? c : d)`` in array sizes and leave assertions out: cffi has no conditional expressions."""

    def choose(match: re.Match[str]) -> str:
        a, b, c, d = map(int, match.groups())
        return str(c if a < b else d)

    text = re.sub(r"typedef char \w+\[\(.*\) \? 1 : -1\];", "", text)
    return re.sub(r"\((\d+) < (\d+) \? (\d+) : (\d+)\)", choose, text)


@cache
def declarations(*headers: str, include: tuple[Path, ...] = (FIRMWARE, TEST), defines: tuple[str, ...] = ()) -> str:
    """What cffi needs to know from some headers, which lie in folders of `include`.

    The macros of the headers do not come along: cffi only wants types and functions.
    """
    includes = "".join(f'#include "{header}"\n' for header in headers)
    with TemporaryDirectory() as folder:
        for name, text in _STANDARD.items():
            (Path(folder) / name).write_text(f"#pragma once\n{text}", encoding="ascii")
        options = [*(f"-I{path}" for path in (folder, *include)), *(f"-D{define}" for define in defines)]
        result = subprocess.run(  # as a compiler without attributes would see it
            ["gcc", "-E", "-P", "-std=c99", "-U__GNUC__", "-nostdinc", *options, "-"],
            input=includes,
            capture_output=True,
            text=True,
            check=True,
        )
    return _without_choices(_without_bodies(result.stdout))
