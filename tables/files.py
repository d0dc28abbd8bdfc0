"""Files that are there as a whole or not at all, and their hash; what is in them is known elsewhere (see store.py, sidecar.py)."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


def write_text_atomically(path: Path, content: str) -> None:
    """Publish a text file: temporary file, fsync, rename."""
    write_bytes_atomically(path, content.encode("utf-8"))


def write_bytes_atomically(path: Path, content: bytes) -> None:
    """Publish a file: temporary file, fsync, rename."""
    with published_file(path) as handle:
        handle.write(content)


@contextmanager
def published_file(path: Path) -> Iterator[IO[bytes]]:
    """A file to write to that appears at `path` when the block ends, whole and on disk; where the block raises, nothing changes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as handle:
        try:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
            os.chmod(handle.name, 0o644)
            if path.is_dir():
                remove(path)
            os.replace(handle.name, path)
        except BaseException:
            Path(handle.name).unlink(missing_ok=True)
            raise


def remove(path: Path) -> None:
    """Remove whatever lies at `path`, if anything does; a folder in the place of a file too, with what is in it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as 64 hexadecimal digits."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
