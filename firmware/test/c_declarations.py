"""Declarations for cffi from the C headers, so that the layouts of tests and firmware agree.

cffi parses C without function bodies and without system headers. The preprocessor uses empty standard headers, and
inline functions are reduced to prototypes; ``core_inlines.c`` defines them.
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
    """Replace every inline function by its prototype."""
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
    """Evaluate ``(a < b ? c : d)`` in array sizes and remove assertions, as cffi has no conditional expressions."""

    def choose(match: re.Match[str]) -> str:
        a, b, c, d = map(int, match.groups())
        return str(c if a < b else d)

    text = re.sub(r"typedef char \w+\[\(.*\) \? 1 : -1\];", "", text)
    return re.sub(r"\((\d+) < (\d+) \? (\d+) : (\d+)\)", choose, text)


@cache
def declarations(*headers: str, include: tuple[Path, ...] = (FIRMWARE, TEST), defines: tuple[str, ...] = ()) -> str:
    """Types and functions of headers in the folders `include`, for cffi.

    Macros of the headers are not included.
    """
    includes = "".join(f'#include "{header}"\n' for header in headers)
    with TemporaryDirectory() as folder:
        for name, text in _STANDARD.items():
            (Path(folder) / name).write_text(f"#pragma once\n{text}", encoding="ascii")
        options = [*(f"-I{path}" for path in (folder, *include)), *(f"-D{define}" for define in defines)]
        result = subprocess.run(  # without compiler attributes
            ["gcc", "-E", "-P", "-std=c99", "-U__GNUC__", "-nostdinc", *options, "-"],
            input=includes,
            capture_output=True,
            text=True,
            check=True,
        )
    return _without_choices(_without_bodies(result.stdout))
