"""Versions of the packages that a table or a label may depend on."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib import metadata


def library_versions(names: Iterable[str]) -> dict[str, str]:
    """Installed version of each package by the name it has in a package index; `python` is the interpreter's.

    A package that is not there has the version "not installed", so that its arrival is a change like any other.
    """
    return {name: platform.python_version() if name == "python" else _version(name) for name in names}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"
