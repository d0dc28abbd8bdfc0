"""Both commands of the ranker, run so that they must refuse: one line on stderr, exit code 1, and no file changed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from model import scoring, training


class Commands:
    """Both commands; each way to run one demands that it refuses."""

    def __init__(self, release: Path, checkpoint: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        self.release, self.checkpoint, self.tmp_path, self.capfd = release, checkpoint, tmp_path, capfd

    def training(self, out: Path | None = None, *more: str) -> str:
        arguments = ["--release", str(self.release), "--out", str(out or self.tmp_path / "new" / "ranker"), "--setting", "light", *more]
        return self._refused(training.main, arguments)

    def scoring(self, out: Path | None = None, checkpoint: Path | None = None, *more: str) -> str:
        arguments = ["--release", str(self.release), "--checkpoint", str(checkpoint or self.checkpoint)]
        return self._refused(scoring.main, [*arguments, "--out", str(out or self.tmp_path / "new" / "predictions.parquet"), *more])

    def both(self) -> str:
        """The line that both commands say."""
        said = self.training()
        assert self.scoring() == said
        return said

    def _refused(self, main: Callable[[list[str]], int], arguments: list[str]) -> str:
        before = contents(self.tmp_path)
        self.capfd.readouterr()
        assert main(arguments) == 1
        (line,) = self.capfd.readouterr().err.splitlines()
        assert contents(self.tmp_path) == before
        assert line.startswith("error: ")
        return line


def contents(folder: Path) -> dict[Path, bytes | None]:
    """Every file below a folder with its bytes; a folder has None."""
    return {path: path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}
