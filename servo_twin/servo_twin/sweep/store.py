"""Results on disk, a line each in the order in which they come: a run that ends early can be gone on with.

The first line says what they are results of. A line that a crash has cut short is dropped. Only the place of each line
is kept in memory, eight bytes per trial.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final

import numpy as np

from servo_twin.sweep.trial import Trial

RESULTS: Final = "trials.jsonl"
_ABSENT: Final = -1


class StoreError(ValueError):
    """The results that are there are not those of this sweep; the message says what to do."""


class Store:
    """Results of one sweep.

    Parameters
    ----------
    folder : Path
        Where they are; made if it is not there.
    head : mapping
        What they are results of, as JSON.
    count : int
        Number of trials.
    resume : bool
        Go on with results that are there.

    Raises
    ------
    StoreError
        If there are results, and they are not to be gone on with or are those of something else.
    """

    def __init__(self, folder: Path, head: Mapping[str, Any], count: int, resume: bool) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / RESULTS
        self._places = np.full(count, _ABSENT, dtype=np.int64)
        if self.path.exists() and not resume:
            raise StoreError(f"{self.path} is there already: --resume goes on with it, --out FOLDER begins elsewhere")
        fresh = not self.path.exists()
        self._file: IO[bytes] = self.path.open("w+b" if fresh else "r+b")
        text = json.dumps(head, sort_keys=True)
        if fresh:
            self._file.write(text.encode() + b"\n")
            self._file.flush()
        else:
            self._read(text)

    def _read(self, head: str) -> None:
        first = self._file.readline()
        if first != head.encode() + b"\n":
            self._file.close()
            raise StoreError(f"{self.path} has the results of another sweep: give the same options, or another --out")
        place = self._file.tell()
        for line in self._file:
            if not line.endswith(b"\n"):
                break
            self._places[json.loads(line)["number"]] = place
            place += len(line)
        self._file.seek(place)
        self._file.truncate()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def __len__(self) -> int:
        return int(np.count_nonzero(self._places != _ABSENT))

    @property
    def missing(self) -> list[int]:
        """Numbers without a result."""
        found: list[int] = np.flatnonzero(self._places == _ABSENT).tolist()
        return found

    def add(self, trial: Trial) -> None:
        """Keep a result: from here on it survives whatever becomes of this process."""
        place = self._file.seek(0, 2)
        self._file.write(json.dumps(trial.as_dict()).encode() + b"\n")
        self._file.flush()
        self._places[trial.number] = place  # last: Ctrl-C may interrupt anything above

    def __iter__(self) -> Iterator[Trial]:
        """Results by number."""
        for place in self._places[self._places != _ABSENT]:
            self._file.seek(int(place))
            yield Trial.of_dict(json.loads(self._file.readline()))
