"""``write_file``: whole files only, and their name in the error."""

from __future__ import annotations

import errno
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import write_file

LARGE = "x" * 100_000


@pytest.fixture
def full() -> Iterator[None]:
    """A file larger than 4096 bytes cannot be written (EFBIG), as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_file_is_replaced_with_its_permissions_through_a_link(tmp_path: Path) -> None:
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("old")
    file.chmod(0o640)
    link.symlink_to(file)
    write_file(link, lambda stream: stream.write("né\n".encode()))
    assert (link.is_symlink(), file.read_bytes(), file.stat().st_mode & 0o777) == (True, "né\n".encode(), 0o640)
    write_file(tmp_path / "new" / "file", b"\0")
    assert (tmp_path / "new" / "file").read_bytes() == b"\0"


@pytest.mark.usefixtures("full")
@pytest.mark.parametrize("old", ["old", None])
def test_a_full_disk_leaves_the_old_file_or_none(old: str | None, tmp_path: Path) -> None:
    file = tmp_path / "file"
    if old is not None:
        file.write_text(old)
    with pytest.raises(OSError, match=str(file)) as caught:
        write_file(file, LARGE)
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(file))
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == ([("file", old)] if old else [])


@pytest.mark.parametrize("suffix", ["", ".png", ".svg", ".pdf"])
def test_a_picture_on_a_full_device_is_an_error_with_its_name(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"file{suffix}"
    file.symlink_to("/dev/full")
    with pytest.raises(OSError, match=f"No space left on device: '{file}'"):
        write_figure(new_figure(1.0, 1.0), file)
