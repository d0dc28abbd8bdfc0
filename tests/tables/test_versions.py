"""Versions are those that are installed; what is not installed says so."""

from __future__ import annotations

import platform
from importlib import metadata

import numpy as np
import pyarrow as pa

from tables.versions import library_versions


def test_versions_are_those_of_the_imported_packages() -> None:
    assert library_versions(["numpy", "pyarrow", "python"]) == {
        "numpy": np.__version__,
        "pyarrow": pa.__version__,
        "python": platform.python_version(),
    }


def test_a_name_in_the_index_may_differ_from_the_module() -> None:
    assert library_versions(["pin"]) == {"pin": metadata.version("pin")}


def test_what_is_not_installed_says_so() -> None:
    assert library_versions(["no-such-engine"]) == {"no-such-engine": "not installed"}
    assert library_versions([]) == {}
