"""Report of a commissioning: one HTML page beside its pictures."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Final

from servo_bridge.commissioning.figure import Figure
from servo_bridge.commissioning.pack import Pack

_STYLE: Final = (
    "body{font-family:sans-serif;max-width:60em;margin:2em auto;padding:0 1em}td,th{padding:.15em .8em;text-align:left}"
    "td:nth-child(2){text-align:right}img{max-width:100%}.no{color:#b00020;font-weight:bold}"
)


def page(pack: Pack, trouble: str = "") -> str:
    """HTML page of all results, and the reason why the sequence has ended early; empty if it has not."""
    title = f"Commissioning of {pack.subject['axis']}"
    return "\n".join(
        [
            f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>',
            f"<h1>{title}</h1>",
            "<table>",
            *(f"<tr><th>{escape(name)}<td>{escape(str(value))}" for name, value in pack.subject.items()),
            "</table>",
            *(f'<p class="no">{escape(text)}' for text in [trouble] if text),
            *_steps(pack),
            "</html>",
        ]
    )


def _steps(pack: Pack) -> Iterator[str]:
    for name, done in pack.done.items():
        yield f"<h2>{escape(name)}</h2>"
        if done.figures:
            yield "<table>" + "".join(map(_row, done.figures)) + "</table>"
        for text in done.texts:
            yield f"<p>{escape(text)}"
        for picture in done.pictures:
            yield f'<p><img src="{escape(picture)}" alt="{escape(picture)}">'


def _row(figure: Figure) -> str:
    cells = "".join(f"<td>{escape(cell)}" for cell in figure.cells())
    return f"<tr>{cells}" if figure.plausible else f'<tr class="no">{cells}'
