"""The README's queries run on a release as they stand there, and its commands exist."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from splits.citation import load_citation
from splits.data_card import PAPER_CITATION
from splits.release import write_release
from tables.store import read_table
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.splits.damage import PROVENANCE

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PUBLISHING = (ROOT / "splits" / "PUBLISHING.md").read_text(encoding="utf-8")
QUERIES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("readme")
    loose = write_synthetic_release(folder / "loose", n_scenes=6, seed=1)
    tables = {schema.name: read_table(schema, loose / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    # Its scenes are the first of `full`; the README's folders are the one in the repository and the one that `make demo` writes.
    for name in ("full", "mini"):
        write_release(tables, folder / "data" / "release" / name, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    return folder


def test_there_are_queries() -> None:
    assert len(QUERIES) >= 3


@pytest.mark.parametrize("query", QUERIES, ids=[" ".join(query.split()[:2]) for query in QUERIES])
def test_a_query_prints_rows(
    query: str, folder: Path, hub_datasets: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    exec(compile(query, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    shape = re.search(r"shape: \((\d+), (\d+)\)", printed)
    assert len(printed.splitlines()) >= 3
    assert ("polars" not in query and "Release" not in query) or (shape is not None and int(shape.group(1)) >= 1)


@pytest.mark.parametrize("library", ["polars", "pandas", "duckdb", "pyarrow", "datasets"])
def test_there_is_a_query_in_each_library(library: str) -> None:
    assert any(re.search(rf"^(import|from) {library}\b", query, re.MULTILINE) for query in QUERIES)


def test_the_first_query_counts_every_candidate(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    scope: dict[str, object] = {}
    exec(compile(QUERIES[0], "README.md", "exec"), scope)
    counted = scope["candidates"].group_by(scope["outcome"].alias("outcome")).len().collect()  # type: ignore[attr-defined]
    assert counted["len"].sum() == pl.read_parquet("data/release/full/candidates").height
    assert counted["outcome"].null_count() == 0


def test_every_make_target_that_is_documented_exists() -> None:
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert set(re.findall(r"`?make (\w+)", README + PUBLISHING)) <= targets


def test_every_module_that_is_documented_exists() -> None:
    for module in set(re.findall(r"python -m ([\w.]+)", README + PUBLISHING)):
        assert (ROOT / Path(*module.split("."))).with_suffix(".py").exists(), module


def test_it_says_how_to_cite_as_the_card_does() -> None:
    citation = load_citation()
    assert citation.bibtex("full", citation.version) in README
    assert PAPER_CITATION in README


def test_every_picture_and_file_that_it_links_to_is_there() -> None:
    linked = re.findall(r"\]\(([^)#:]+)\)", README)
    assert {"reports/pictures/executions.png", "reports/pictures/ladder.png", "reports/pictures/chain.png"} <= set(linked)
    assert [path for path in linked if not (ROOT / path).exists()] == []
    assert [path for path in linked if path.endswith(".png") and (ROOT / path).stat().st_size > 300_000] == []


def test_preformatted_text_fits_a_terminal_where_it_shows_one() -> None:
    (shown,) = re.findall(r"<details>.*?```\n(.*?)```.*?</details>", README, flags=re.DOTALL)
    assert max(map(len, shown.splitlines())) <= 80
