"""Progress line in the terminal."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Final, TextIO

_WIDTH: Final = 30
_PERIOD: Final = 0.1  # shortest period of updates [s]


class ProgressLine:
    """Shows a text or a bar if the stream is a terminal; cleared at the end of the ``with`` block.

    Parameters
    ----------
    stream : file, optional
        Default: standard error, so that the output of a command can be piped.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._shown = self._stream.isatty()
        self._due = 0.0

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown:
            self._write("")

    def text(self, text: str) -> None:
        """Show a text."""
        if self._shown and time.monotonic() >= self._due:
            self._write(text)

    def bar(self, label: str, done: int, total: int) -> None:
        """Show a progress bar."""
        if not self._shown or (done < total and time.monotonic() < self._due):
            return
        part = done / total if total else 1.0
        filled = round(part * _WIDTH)
        self._write(f"{label} [{'#' * filled}{'.' * (_WIDTH - filled)}] {part:4.0%}")

    def _write(self, text: str) -> None:
        self._due = time.monotonic() + _PERIOD
        self._stream.write(f"\r\x1b[K{text}")
        self._stream.flush()
