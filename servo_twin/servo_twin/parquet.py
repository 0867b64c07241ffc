"""Parquet files; pyarrow is imported when one is written."""

from __future__ import annotations

import importlib
from typing import Any


class ParquetError(ValueError):
    """A Parquet file cannot be written; the text has reason and remedy."""


def import_parquet() -> tuple[Any, Any]:
    """The modules ``pyarrow`` and ``pyarrow.parquet``, which have no type hints.

    Raises
    ------
    ParquetError
        If pyarrow is not installed.
    """
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise ParquetError(f"Parquet needs pyarrow ({error}): pip install pyarrow") from None
