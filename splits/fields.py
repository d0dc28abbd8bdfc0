"""Checks of single fields that came from a file and may hold anything.

Each takes the name of the field and its value, and raises ReleaseError with both and the bound where the sentence below does not hold.
"""

from __future__ import annotations

import re

from splits.errors import ReleaseError, shown

_SHA256 = re.compile(r"[0-9a-f]{64}")
_NUMBER = "(?:0|[1-9][0-9]{0,5})"
_VERSION = re.compile(rf"{_NUMBER}\.{_NUMBER}\.{_NUMBER}")


def check_equal(name: str, value: object, expected: object) -> None:
    """The field is exactly this."""
    if value != expected:
        raise ReleaseError(f"{name} {shown(value)}, must be {expected!r}")


def check_count(name: str, value: object) -> None:
    """The field is a whole number of at least 0; True and False do not count as numbers."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ReleaseError(f"{name} {shown(value)}, must be a whole number of at least 0")


def check_sha256(name: str, value: object) -> None:
    """The field is a SHA-256 in hexadecimal."""
    if not isinstance(value, str) or not _SHA256.fullmatch(value):
        raise ReleaseError(f"{name} {shown(value)}, must be 64 hex digits")


def check_version(name: str, value: object) -> tuple[int, int, int]:
    """The field is `major.minor.patch`; returns the three numbers."""
    if not isinstance(value, str) or not _VERSION.fullmatch(value):
        raise ReleaseError(f"{name} {shown(value)}, must be major.minor.patch")
    major, minor, patch = map(int, value.split("."))
    return major, minor, patch


def check_texts(name: str, value: object) -> None:
    """The field maps texts to texts, none of them empty."""
    if not isinstance(value, dict):
        raise ReleaseError(f"{name} {shown(value)}, must be an object of texts")
    for key, text in value.items():
        for part in (key, text):
            if not isinstance(part, str) or not part.strip():
                raise ReleaseError(f"{name}.{key} {shown(text)}, name and value must be texts that are not empty")
