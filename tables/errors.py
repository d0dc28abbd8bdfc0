"""The one family of errors: whatever the project itself refuses is a PlaceBenchError; each room names its own kinds."""

from __future__ import annotations

# What a command returns that Ctrl-C ended, as a shell does.
INTERRUPTED = 130


class PlaceBenchError(Exception):
    """Broken input, a damaged file or a broken rule; the message names the thing, the value and the bound.

    A command line catches this class and prints the message. Anything else that reaches it is a bug and shows its traceback.
    """
