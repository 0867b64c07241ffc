"""Progress bar of a command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NoReturn

if TYPE_CHECKING:
    from tqdm import tqdm

_BAR: Final = "{desc}{percentage:3.0f}%|{bar:30}|"


def progress_bar() -> tqdm[NoReturn]:
    """Bar on standard error, so that the output can be piped: on a terminal only, erased when it is closed."""
    from tqdm import tqdm  # only now: other commands start faster

    return tqdm(bar_format="{desc}", miniters=0, disable=None, leave=False)


def show(bar: tqdm[NoReturn], text: str, done: int = 0, total: int | None = None) -> None:
    """Show a text, and the part that is done if the total is known; at most ten times a second."""
    bar.bar_format = _BAR if total else "{desc}"
    bar.total = total
    bar.set_description_str(text, refresh=False)
    bar.update(done - bar.n)
