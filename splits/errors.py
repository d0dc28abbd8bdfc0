"""The error that every check of a release raises, and how a value is shown in it."""

from __future__ import annotations

from tables.errors import PlaceBenchError

_MAX_SHOWN = 80


class ReleaseError(PlaceBenchError, RuntimeError):
    """A release that is incomplete, changed, or wrong; one line that names the file or rule, the value and the bound."""

    def __init__(self, message: str) -> None:
        # Library errors quoted in a message may run over several lines; a log and a terminal show one line per finding.
        super().__init__(" ".join(message.split()))


def shown(value: object) -> str:
    """The value as an error shows it: its repr, cut where a damaged file would fill the screen."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN - 3]}..."
