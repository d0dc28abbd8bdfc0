"""The texts of a release, made from its tables and its manifest and nothing else, so that they can be made again and compared.

The card is for people and hubs, `croissant.json` for machines, the datasheet for whoever decides whether to use the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from itertools import zip_longest
from pathlib import Path

import pyarrow as pa

from splits.citation import load_citation
from splits.croissant import render_croissant
from splits.data_card import render_card
from splits.datasheet import render_datasheet
from splits.errors import ReleaseError, shown
from splits.manifest import CARD, CROISSANT, DATASHEET, Manifest, files_of_table
from splits.own import citation_of
from splits.summary import summary_of


def render_texts(tables: Mapping[str, pa.Table], manifest: Manifest) -> dict[str, str]:
    """Every text by its file name.

    Args:
        tables: tables of the release; heavy ones may be missing, a light release has the texts of the whole one.
        manifest: of the release; its entries of the texts themselves are not looked at.
    """
    citation, summary = citation_of(load_citation(), manifest.provenance), summary_of(tables)
    rows = {name: entry.rows for name, entry in manifest.tables.items()}
    sizes = {name: sum(manifest.files[file].bytes for file in files_of_table(name)) for name in manifest.tables}
    return {
        CARD: render_card(tables, _facts(manifest), rows, sizes, citation),
        CROISSANT: render_croissant(manifest, summary, citation),
        DATASHEET: render_datasheet(manifest, summary, citation),
    }


def check_texts(directory: Path, tables: Mapping[str, pa.Table], manifest: Manifest) -> None:
    """Raise ReleaseError where a text in the folder is not what the data make; names the first line that differs."""
    for name, expected in render_texts(tables, manifest).items():
        found = (directory / name).read_text(encoding="utf-8", errors="replace")
        if found == expected:
            continue
        lines = zip_longest(found.splitlines(), expected.splitlines())
        k, (own, made) = next(((k, pair) for k, pair in enumerate(lines, 1) if pair[0] != pair[1]), (0, ("", "")))
        raise ReleaseError(f"{name}: line {k} is {shown(own)}, the data make {shown(made)} (`python -m splits.release render` writes it)")


def _facts(manifest: Manifest) -> dict[str, str]:
    """What the tables do not say, as the card lists it."""
    return {
        **manifest.provenance,
        "tier": manifest.tier,
        "version": manifest.version,
        "licence": manifest.licence,
        "schema_version": manifest.schema_version,
        "release_hash": manifest.release_hash,
        **{f"tolerances.{name}": f"{value:.4g}" for name, value in asdict(manifest.tolerances).items()},
        "scenes_of_tier": str(len(manifest.layout.scenes_of_tier(manifest.tier))),
    }
