"""Where a command may write: asked before the work starts, and one kind of error where writing fails all the same."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from model.errors import OutputError, one_line
from tables.store import StoreError


def check_writable(path: Path) -> None:
    """Raise OutputError where the file `path` could not be written; makes nothing, not even a missing folder."""
    folder = path.parent
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder, must be a file or not exist")
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        if not folder.is_dir():
            raise OutputError(f"{path}: cannot be written, {folder} is not a folder")
        # A file that is gone when it is closed: permission bits do not tell what a read-only or a virtual file system refuses.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"{path}: cannot be written, {folder} takes no files ({error.strerror})") from error


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns what fails while `path` is written into an OutputError that names it."""
    try:
        yield
    except (OSError, StoreError) as error:
        raise OutputError(f"{path}: cannot be written ({one_line(error)})") from error
