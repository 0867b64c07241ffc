"""Results file, one line per trial in the order of completion, so that an interrupted run can be continued.

The first line identifies the sweep. An incomplete last line is dropped. Only the offset of each line is kept in memory,
eight bytes per trial.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final

import numpy as np
from servo_msgs_py.output_file import named

from servo_twin.validation.sweep.trial import Trial

RESULTS: Final = "trials.jsonl"
_ABSENT: Final = -1
_LINE_BYTES: Final = 1 << 20
"""Longest line that is read; one of a trial is shorter by far."""


class StoreError(ValueError):
    """Existing results do not belong to this sweep; the message contains the remedy."""


class Store:
    """Results of one sweep.

    Parameters
    ----------
    folder : Path
        Folder of the results; created if missing.
    head : mapping
        Identification of the sweep, as JSON.
    count : int
        Number of trials.
    resume : bool
        Continue with existing results.

    Raises
    ------
    StoreError
        If there are results and `resume` is false, or they belong to another sweep.
    """

    def __init__(self, folder: Path, head: Mapping[str, Any], count: int, resume: bool) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / RESULTS
        self._offsets = np.full(count, _ABSENT, dtype=np.int64)
        if self.path.exists() and not resume:
            raise StoreError(f"{self.path} exists: continue with --resume, or choose another folder with --out")
        new = not self.path.exists()
        self._file: IO[bytes] = self.path.open("w+b" if new else "r+b")
        text = json.dumps(head, sort_keys=True)
        if new:
            self._append(text)
        else:
            self._read(text)

    def _read(self, head: str) -> None:
        expected = head.encode() + b"\n"
        if self._file.readline(len(expected)) != expected:
            self._file.close()
            raise StoreError(f"{self.path} belongs to another sweep: use the same options or another --out")
        offset = self._file.tell()
        for line in iter(partial(self._file.readline, _LINE_BYTES), b""):
            if not line.endswith(b"\n"):
                break
            self._offsets[json.loads(line)["number"]] = offset
            offset += len(line)
        self._file.seek(offset)
        self._file.truncate()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def __len__(self) -> int:
        return int(np.count_nonzero(self._offsets != _ABSENT))

    @property
    def missing(self) -> list[int]:
        """Numbers without a result."""
        found: list[int] = np.flatnonzero(self._offsets == _ABSENT).tolist()
        return found

    def add(self, trial: Trial) -> None:
        """Write a result to the file."""
        offset = self._file.seek(0, 2)
        self._append(json.dumps(trial.as_dict()))
        self._offsets[trial.number] = offset  # last, because Ctrl-C may interrupt the lines above

    def _append(self, line: str) -> None:
        with named(self.path):
            self._file.write(line.encode() + b"\n")
            self._file.flush()

    def __iter__(self) -> Iterator[Trial]:
        """Results in the order of their numbers."""
        for offset in self._offsets[self._offsets != _ABSENT]:
            self._file.seek(int(offset))
            yield Trial.of_dict(json.loads(self._file.readline(_LINE_BYTES)))
