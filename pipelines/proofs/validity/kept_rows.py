"""The rows of one study on disk, one JSON line a row as it finishes: a killed run loses the units in work and nothing else.

The first line says what the rows were made from. A file that was made from anything else holds no rows: it is begun anew.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from pipelines.codecs import Row
from tables.files import write_text_atomically


class KeptRows:
    """Context manager: the rows that are there, and more of them as they come.

    Args:
        path: of the file; its folder is made.
        made_from: what decides every row besides the unit's key, such as hashes of code, parameters and release.
    """

    def __init__(self, path: Path, made_from: Mapping[str, str]) -> None:
        self.path = path
        self._header = _line({"made_from": dict(made_from)})
        self._rows: dict[str, Row] = {}
        self._handle: BinaryIO | None = None

    def __enter__(self) -> Self:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        whole = self._whole_lines()
        if whole is None:
            write_text_atomically(self.path, self._header)
        # Unbuffered: a line is one write, which the kernel has when the process is killed after it.
        self._handle = self.path.open("r+b", buffering=0)
        if whole is not None:
            # What a kill has left of a line is cut off.
            self._handle.truncate(whole)
        self._handle.seek(0, 2)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._handle is not None:
            self._handle.close()
            self._handle = None

    @property
    def rows(self) -> Mapping[str, Row]:
        """Rows by the keys of their units."""
        return self._rows

    def add(self, key: str, row: Row) -> None:
        """Keep the row of a unit."""
        if self._handle is None:
            raise RuntimeError(f"{self.path}: rows are kept inside the block only")
        line = _line({"unit": key, "row": row})
        self._handle.write(line.encode())
        self._rows[key] = json.loads(line)["row"]

    def put_in_order(self, keys: Sequence[str]) -> None:
        """End the block with the rows of these units in their order and no others, so that equal rows are an equal file."""
        self.__exit__(None, None, None)
        lines = [_line({"unit": key, "row": self._rows[key]}) for key in keys]
        write_text_atomically(self.path, "".join([self._header, *lines]))

    def _whole_lines(self) -> int | None:
        """Read the rows; the bytes up to the end of the last whole line, None where the file is not there or of something else."""
        try:
            content = self.path.read_bytes()
        except OSError:
            return None
        end = content.rfind(b"\n") + 1
        first, *lines = content[:end].splitlines() or [b""]
        if first.decode("utf-8", errors="replace") + "\n" != self._header:
            return None
        for line in lines:
            try:
                entry = json.loads(line)
                self._rows[entry["unit"]] = entry["row"]
            except (ValueError, KeyError, TypeError):
                # Damaged in the middle, which no kill does: nothing of it is believed.
                self._rows.clear()
                return None
        return end


def _line(entry: Mapping[str, Any]) -> str:
    return json.dumps(entry, sort_keys=True, separators=(",", ":")) + "\n"
