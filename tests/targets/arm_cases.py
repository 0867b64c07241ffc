"""Random instructions of a Cortex-M4 as cases for ``native/arm_cases.c``, in groups by their decoding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Final

_LOW: Final = 8
_ALL: Final = 13
"""Registers that a case may use: r0 to r12."""


@dataclass(frozen=True)
class Case:
    """Some instructions."""

    group: str  # name of the generator
    halves: tuple[int, ...]  # half words
    addresses: int = 0  # mask of registers that are addresses
    offsets: int = 0  # mask of registers that are small offsets

    def __str__(self) -> str:
        return f"{self.group}: {' '.join(f'{half:04x}' for half in self.halves)}"


def _wide(first: int, second: int) -> tuple[int, int]:
    return first, second


# ---- short instructions ---------------------------------------------------------------------------------------------


def _short_data(r: Random) -> tuple[int, ...]:
    kind = r.randrange(6)
    if kind == 0:
        return (r.randrange(0x2000),)  # shifts by immediates, sums of three registers
    if kind == 1:
        return (r.randrange(0x2000, 0x4000),)  # immediates
    if kind == 2:
        return (0x4000 | r.randrange(0x400),)  # two registers
    if kind == 3:
        m, d = r.randrange(_ALL), r.randrange(_ALL)  # high registers
        return (0x4400 | r.choice((0, 0x100, 0x200)) | m << 3 | (d & 7) | (d & 8) << 4,)
    if kind == 4:
        return (0xB200 | r.randrange(0x100),)  # extensions
    return (r.choice((0xBA00, 0xBA40, 0xBAC0)) | r.randrange(64),)  # reversals


def _short_memory(r: Random) -> Case:
    n, m, t = r.sample(range(_LOW), 3)
    if r.randrange(2):
        half = 0x5000 | r.randrange(8) << 9 | m << 6 | n << 3 | t
        return Case("short memory", (half,), 1 << n, 1 << m)
    half = r.choice((0x6000, 0x6800, 0x7000, 0x7800, 0x8000, 0x8800)) | r.randrange(16) << 6 | n << 3 | t
    return Case("short memory", (half,), 1 << n)


def _short_multiple(r: Random) -> Case:
    n, mask = r.randrange(_LOW), r.randrange(1, 256)
    if r.randrange(2):  # LDM
        return Case("multiple", (0xC800 | n << 8 | mask,), 1 << n)
    return Case("multiple", (0xC000 | n << 8 | (mask & ~(1 << n) or 1 << (n + 1) % 8),), 1 << n)


# ---- long instructions ----------------------------------------------------------------------------------------------


_DATA: Final = (0, 1, 2, 3, 4, 8, 10, 11, 13, 14)
_TESTS: Final = (0, 4, 8, 13)


def _data_fields(r: Random) -> tuple[int, int, int, int]:
    """Operation, S, n and d; with tests, moves and negated moves."""
    code, flags, n, d = r.choice(_DATA), r.randrange(2), r.randrange(_ALL), r.randrange(_ALL)
    if r.randrange(4) == 0:
        code, flags, d = r.choice(_TESTS), 1, 15
    elif r.randrange(4) == 0:
        code, n = r.choice((2, 3)), 15
    return code, flags, n, d


def _long_immediate(r: Random) -> tuple[int, ...]:
    code, flags, n, d = _data_fields(r)
    imm = r.randrange(4096)
    if imm >> 8 in (1, 2, 3) and imm & 0xFF == 0:
        imm |= 1  # not predictable
    return _wide(0xF000 | (imm >> 11) << 10 | code << 5 | flags << 4 | n, (imm >> 8 & 7) << 12 | d << 8 | imm & 0xFF)


def _long_shifted(r: Random) -> tuple[int, ...]:
    code, flags, n, d = _data_fields(r)
    if r.randrange(8) == 0:  # PKHBT, PKHTB
        second = r.randrange(8) << 12 | r.randrange(_ALL) << 8 | r.randrange(4) << 6 | r.randrange(2) << 5
        return _wide(0xEAC0 | r.randrange(_ALL), second | r.randrange(_ALL))
    second = r.randrange(8) << 12 | d << 8 | r.randrange(4) << 6 | r.randrange(4) << 4 | r.randrange(_ALL)
    return _wide(0xEA00 | code << 5 | flags << 4 | n, second)


def _plain_immediate(r: Random) -> tuple[int, ...]:
    n, d, imm3, low = r.randrange(_ALL), r.randrange(_ALL), r.randrange(8), r.randrange(256)
    code = r.choice((0x00, 0x04, 0x0A, 0x0C))
    n = r.randrange(16) if code in (4, 12) else n
    return _wide(0xF200 | r.randrange(2) << 10 | code << 4 | n, imm3 << 12 | d << 8 | low)


def _fields(r: Random) -> tuple[int, ...]:
    n, d, lsb = r.randrange(_ALL), r.randrange(_ALL), r.randrange(32)
    code = r.choice((0x14, 0x16, 0x1C))
    width = r.randrange(1, 33 - lsb)
    last = lsb + width - 1 if code == 0x16 else width - 1
    n = 15 if code == 0x16 and r.randrange(3) == 0 else n
    return _wide(0xF200 | code << 4 | n, (lsb >> 2) << 12 | d << 8 | (lsb & 3) << 6 | last)


def _saturations(r: Random) -> tuple[int, ...]:
    n, d, code = r.randrange(_ALL), r.randrange(_ALL), r.choice((0x10, 0x12, 0x18, 0x1A))
    amount = r.randrange(32)
    halves = code & 2 and amount == 0
    return _wide(
        0xF200 | code << 4 | n, (amount >> 2) << 12 | d << 8 | (amount & 3) << 6 | r.randrange(16 if halves else 32)
    )


def _long_registers(r: Random) -> tuple[int, ...]:
    n, d, m = r.randrange(_ALL), r.randrange(_ALL), r.randrange(_ALL)
    kind = r.randrange(4)
    if kind == 0:  # shifts
        return _wide(0xFA00 | r.randrange(8) << 4 | n, 0xF000 | d << 8 | m)
    if kind == 1:  # extensions, added or not
        n = r.choice((n, 15))
        return _wide(0xFA00 | r.randrange(6) << 4 | n, 0xF080 | d << 8 | r.randrange(4) << 4 | m)
    if kind == 2:  # QADD and relatives, SEL
        code, second = r.choice(((0, 0), (0, 1), (0, 2), (0, 3), (2, 0)))
        return _wide(0xFA80 | code << 4 | n, 0xF080 | d << 8 | second << 4 | m)
    code, second = r.choice(((1, 0), (1, 1), (1, 2), (1, 3), (3, 0)))  # reversals, CLZ
    return _wide(0xFA80 | code << 4 | m, 0xF080 | d << 8 | second << 4 | m)


def _parallel(r: Random) -> tuple[int, ...]:
    n, d, m = r.randrange(_ALL), r.randrange(_ALL), r.randrange(_ALL)
    prefix = r.choice((0, 1, 2, 4, 5, 6))
    return _wide(0xFA80 | r.choice((0, 1, 2, 4, 5, 6)) << 4 | n, 0xF000 | d << 8 | prefix << 4 | m)


def _products(r: Random) -> tuple[int, ...]:
    n, d, m, a = r.randrange(_ALL), r.randrange(_ALL), r.randrange(_ALL), r.randrange(_ALL)
    code, second = r.choice(((0, (0, 1)), (1, range(4)), *((k, (0, 1)) for k in (2, 3, 4, 5, 6)), (7, (0,))))
    low = r.choice(second)
    with_sum = code == 6 or (code == 0 and low == 1) or r.randrange(2)
    return _wide(0xFB00 | code << 4 | n, (a if with_sum else 15) << 12 | d << 8 | low << 4 | m)


def _wide_products(r: Random) -> tuple[int, ...]:
    n, m = r.randrange(_ALL), r.randrange(_ALL)
    d, a = r.sample(range(_ALL), 2)
    code, second = r.choice(
        (
            *((0, 0), (2, 0), (4, 0), (6, 0), (6, 6), (4, 12), (4, 13), (5, 12), (5, 13)),
            *((4, k) for k in range(8, 12)),
        )
    )
    return _wide(0xFB80 | code << 4 | n, a << 12 | d << 8 | second << 4 | m)


def _divisions(r: Random) -> tuple[int, ...]:
    n, m, d = r.randrange(_ALL), r.randrange(_ALL), r.randrange(_ALL)
    return _wide(0xFB90 | r.choice((0, 2)) << 4 | n, 0xF0F0 | d << 8 | m)


def _long_memory(r: Random) -> Case:
    n, m, t = r.sample(range(_ALL), 3)
    size, load = r.randrange(3), r.randrange(2)
    signed = load and size < 2 and r.randrange(2)
    first = 0xF800 | signed << 8 | size << 5 | load << 4 | n
    kind = r.randrange(3)
    if kind == 0:
        return Case("long memory", _wide(first | 0x80, t << 12 | r.randrange(96)), 1 << n)
    if kind == 1:
        return Case("long memory", _wide(first, t << 12 | r.randrange(4) << 4 | m), 1 << n, 1 << m)
    mode = r.choice((0xC, 0x9, 0xB, 0xD, 0xF))  # P, U, W behind the first bit
    return Case("long memory", _wide(first, t << 12 | mode << 8 | r.randrange(100)), 1 << n)


def _doubles(r: Random) -> Case:
    n, t, second = r.sample(range(_ALL), 3)
    mode = r.choice((0x100, 0x180, 0x120, 0x1A0, 0x020, 0x0A0))
    first = 0xE840 | mode | r.randrange(2) << 4 | n
    return Case("doubles", _wide(first, t << 12 | second << 8 | r.randrange(25)), 1 << n)


def _long_multiple(r: Random) -> Case:
    n = r.randrange(_ALL)
    mask = (r.randrange(1, 1 << _ALL) & ~(1 << n)) or 1 << (n + 1) % _ALL
    if mask & (mask - 1) == 0:
        mask |= 1 << (n + 2) % _ALL
    direction = r.choice((0x80, 0x100))
    return Case("multiple", _wide(0xE800 | direction | r.randrange(2) << 5 | r.randrange(2) << 4 | n, mask), 1 << n)


# ---- sequences ------------------------------------------------------------------------------------------------------


def _if_then(r: Random) -> tuple[int, ...]:
    """An IT block of one to four instructions with any condition."""
    condition, length = r.randrange(14), r.randrange(1, 5)
    mask = 0
    for k in range(1, length):
        mask |= r.choice((condition & 1, ~condition & 1)) << (4 - k)
    mask |= 1 << (4 - length)
    halves = [0xBF00 | condition << 4 | mask]
    for _ in range(length):
        halves += r.choice((_short_data, _long_immediate, _long_shifted, _products, _divisions))(r)
    return tuple(halves)


def _branches(r: Random) -> tuple[int, ...]:
    """A conditional branch, long, short or with a comparison, over an instruction."""
    over = r.choice((_short_data, _long_immediate))(r)
    kind, skip = r.randrange(3), len(over)
    if kind == 0:
        return 0xD000 | r.randrange(14) << 8 | (skip - 1), *over
    if kind == 1:
        return 0xF000 | r.randrange(14) << 6, 0x8000 | skip, *over
    return 0xB100 | r.randrange(2) << 11 | (skip - 1) << 3 | r.randrange(_LOW), *over


def _table_branch(r: Random) -> Case:
    """A jump by a table of bytes behind the instruction."""
    m = r.randrange(_ALL)
    # Offsets 0..7: four half words of table, then eight MOVS r0, #n, of which the jump omits some.
    table = tuple(2 * k + 4 | (2 * k + 5) << 8 for k in range(4))
    code = tuple(0x3000 | (k % 8) << 8 | (k + 1) for k in range(8))
    return Case("table branch", (0xE8DF, 0xF000 | m, *table, *code), 0, 1 << m)


def _chains(r: Random) -> tuple[int, ...]:
    """Several instructions that use each other's results and flags."""
    halves: list[int] = []
    for _ in range(6):
        halves += r.choice((_short_data, _long_immediate, _long_shifted, _long_registers, _wide_products))(r)
    return tuple(halves)


_PLAIN: Final[dict[str, Callable[[Random], tuple[int, ...]]]] = {
    "short data": _short_data,
    "long immediate": _long_immediate,
    "long shifted": _long_shifted,
    "plain immediate": _plain_immediate,
    "fields": _fields,
    "saturations": _saturations,
    "long registers": _long_registers,
    "parallel": _parallel,
    "products": _products,
    "wide products": _wide_products,
    "divisions": _divisions,
    "if-then": _if_then,
    "branches": _branches,
    "chains": _chains,
}
_MEMORY: Final = (_short_memory, _short_multiple, _long_memory, _doubles, _long_multiple, _table_branch)


def random_cases(seed: int, per_group: int) -> list[Case]:
    """Cases of every group."""
    r = Random(seed)
    cases = [Case(name, make(r)) for name, make in _PLAIN.items() for _ in range(per_group)]
    return cases + [make(r) for make in _MEMORY for _ in range(per_group)]


def assembly(cases: list[Case]) -> str:
    """Assembly text of a table of cases and their code."""
    lines = [".syntax unified", ".thumb", ".text", ".balign 4"]
    for n, case in enumerate(cases):
        lines += [".balign 4", f"case_{n}:", *(f".hword {half:#x}" for half in case.halves), "bx lr"]
    lines += ['.section .rodata,"a"', ".balign 4", ".global cases, cases_count", "cases:"]
    lines += [f".word case_{n} + 1, {case.addresses:#x}, {case.offsets:#x}" for n, case in enumerate(cases)]
    lines += ["cases_count:", f".word {len(cases)}", ""]
    return "\n".join(lines)
