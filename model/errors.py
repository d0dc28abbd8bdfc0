"""The exceptions that model raises on purpose: one family, which a command catches in `main` and reports in one line."""

from __future__ import annotations

from tables.errors import PlaceBenchError


class RankerError(PlaceBenchError, ValueError):
    """Base of every error that this package raises on purpose; the message is one line."""


class SettingsError(RankerError):
    """A setting that cannot be; names field, value and bound."""


class InputError(RankerError):
    """A release that the ranker cannot read; names file, row or column, value and bound."""


class ForbiddenColumnError(InputError):
    """A request for a column that is not one of the five inputs."""


class CheckpointError(RankerError):
    """A checkpoint that is missing, changed or made under another contract."""


class TrainingError(RankerError):
    """A training that cannot start or that diverged."""


class OutputError(RankerError):
    """A place that cannot be written to."""


def one_line(error: BaseException) -> str:
    """The message of a library error in one line: those of pyarrow and torch may span many."""
    words = " ".join(str(error).split())
    return words if len(words) <= 300 else words[:297] + "..."
