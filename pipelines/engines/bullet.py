"""PyBullet, imported without the line that it prints of its build; whoever calls it imports it from here."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

_BUILD_LINE = b"pybullet build time: "
_STDERR = 2


@contextmanager
def _without_build_line() -> Iterator[None]:
    """PyBullet writes the line from C, to the file descriptor; whatever else is written there meanwhile comes after all."""
    sys.stderr.flush()
    stderr = os.dup(_STDERR)
    with tempfile.TemporaryFile() as caught:
        os.dup2(caught.fileno(), _STDERR)
        try:
            yield
        finally:
            os.dup2(stderr, _STDERR)
            os.close(stderr)
            caught.seek(0)
            os.write(_STDERR, b"".join(line for line in caught if not line.startswith(_BUILD_LINE)))


with _without_build_line():
    import pybullet

__all__ = ["pybullet"]
