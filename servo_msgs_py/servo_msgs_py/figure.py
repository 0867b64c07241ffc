"""Pictures without a window; matplotlib is imported when one is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from servo_msgs_py.output_file import write_file


class PictureError(ValueError):
    """A picture cannot be drawn; the message has reason and remedy."""


def check_picture(path: Path) -> None:
    """Check that `write_figure` knows the format of a file.

    Raises
    ------
    PictureError
        If it does not, or matplotlib is not installed.
    """
    known = sorted(f".{suffix}" for suffix in new_figure(1.0, 1.0).canvas.get_supported_filetypes())
    if path.suffix.lower() not in ("", *known):
        raise PictureError(f"{path}: {path.suffix} is no format of a picture; formats: {', '.join(known)}")


def new_figure(width: float, height: float, dpi: int = 100) -> Any:
    """Figure of matplotlib of this size [inch] with automatic layout.

    Raises
    ------
    PictureError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PictureError(f"pictures need matplotlib ({error}): pip install matplotlib") from None
    return Figure(figsize=(width, height), dpi=dpi, layout="constrained", facecolor="white")


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure in the format of the extension, and create its folder.

    Raises
    ------
    PictureError
        If the format is not supported.
    OSError
        If the file cannot be written.
    """
    try:
        write_file(path, lambda file: figure.savefig(file, format=path.suffix.lower().removeprefix(".") or "png"))
    except ValueError as error:
        raise PictureError(f"{path}: {error}") from None
