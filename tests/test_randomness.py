"""Nothing but tables/identity.py makes random numbers: every draw comes from the recipe seed and an identity."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
ROOMS = ("tables", "objects", "pipelines", "splits", "model", "reports", "assets_def")
# Names of types, for annotations.
TYPES = {"np.random.Generator", "numpy.random.Generator"}


def draws(source: str) -> list[str]:
    """Where a source text reaches for random numbers of its own: line number and name."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Attribute):
            names = [ast.unparse(node)]
        else:
            continue
        for name in names:
            parts = name.split(".")
            is_module = parts[0] in ("random", "secrets") or name.startswith(("np.random.", "numpy.random."))
            if name not in TYPES and (is_module or parts[-2:] == ["Rotation", "random"] or parts[-1] in ("default_rng", "urandom")):
                found.append(f"{node.lineno}: {name}")
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_draws_on_its_own(room: str) -> None:
    paths = [path for path in (REPOSITORY / room).rglob("*.py") if path != REPOSITORY / "tables" / "identity.py"]
    assert paths
    assert {str(path.relative_to(REPOSITORY)): found for path in paths if (found := draws(path.read_text(encoding="utf-8")))} == {}


@pytest.mark.parametrize(
    "source",
    [
        "import random",
        "from random import shuffle",
        "from numpy.random import default_rng",
        "x = np.random.default_rng(0)",
        "x = np.random.rand(3)",
        "x = numpy.random.RandomState(1)",
        "x = Rotation.random(256, rng=0)",
        "x = os.urandom(4)",
    ],
)
def test_a_draw_of_its_own_is_found(source: str) -> None:
    assert len(draws(source)) == 1


def test_a_generator_that_is_handed_in_may_be_used() -> None:
    assert draws("def f(rng: np.random.Generator) -> float:\n    return rng.random()\n") == []
