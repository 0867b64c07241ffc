"""Recordings of several files: ``run.mcap``, ``run_1.mcap``, ``run_2.mcap``; the first ones may have been removed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Limits:
    """Bounds of a recording, beyond which its oldest segments are removed."""

    size: float = float("inf")  # of all files [bytes]
    duration: float = float("inf")  # of all files [s]


def segments(path: Path) -> list[Path]:
    """Existing files of a recording, oldest first.

    Parameters
    ----------
    path : Path
        That of the recording, which is also that of its first segment; a later segment stands for itself.
    """
    found = path.parent.glob(f"*{path.suffix}")
    later = (file for file in found if file != path and split(file)[0] == path.stem)
    return [*([path] if path.exists() else []), *sorted(later, key=split)]


def segment(path: Path, number: int) -> Path:
    """Path of a segment of a recording; the first one is number 0."""
    return path if number == 0 else path.with_name(f"{path.stem}_{number}{path.suffix}")


def split(file: Path) -> tuple[str, int]:
    """Name of the recording, and number of the segment."""
    name, _, number = file.stem.rpartition("_")
    return (name, int(number)) if name and number.isdecimal() else (file.stem, 0)
