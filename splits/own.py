"""What the texts of a release say where it is not the benchmark: made from a catalogue or a recipe of somebody's own (provenance.py)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from splits.citation import Citation, Work
from splits.provenance import is_own
from tables.columns import Column, TableSchema
from tables.vocabulary import SplitScheme

# Of a release of one's own; the format is that of the benchmark's.
LICENCE_OF_OWN = "to be stated by whoever publishes it"
ABSTRACT_OF_OWN = (
    "Candidates pair a grasp with a placement target of one scene. Each has two labels: whether a complete placement motion can be planned,"
    " and whether that motion, executed in physics, ends in a valid placement. Made by the pipeline of PlaceBench from objects that are not"
    " those of the benchmark, or by another recipe: figures of PlaceBench may not be compared with figures of these data."
)
OBJECT_SPLIT_OF_OWN = "train, validation or test by object: an object is in one of them alone"
FRICTION_OF_OWN = """\
the friction of objects is what the catalogue says, the stiffness of the pads is chosen within the
  bounds of sources that the engine's parameters name"""
KNOWN_OBJECTS_OF_OWN = """\
- **Known objects.** Column `split` holds out scenes, not objects: an object may occur in all of its parts, and results on it say nothing
  about unseen objects. `split_object` is for that, as far as there are enough objects."""


def table_meaning(schema: TableSchema, provenance: Mapping[str, str]) -> str:
    """What one row of a table is."""
    return schema.meaning.removeprefix("the benchmark: ") if is_own(provenance) else schema.meaning


def column_meaning(column: Column, provenance: Mapping[str, str]) -> str:
    """What a column says."""
    return OBJECT_SPLIT_OF_OWN if is_own(provenance) and column.name == SplitScheme.OBJECT.column else column.meaning


def name_of(provenance: Mapping[str, str]) -> str:
    """What a release is called, without its tier."""
    return f"Dataset of {provenance['catalogue']}" if is_own(provenance) else "PlaceBench"


def title_of(provenance: Mapping[str, str], tier: str, version: str) -> str:
    """What a release is called; the version of one of one's own is that of the format, and no part of its name."""
    return f"{name_of(provenance)}, {tier}" if is_own(provenance) else f"{name_of(provenance)} {tier} {version}"


def notice_of(provenance: Mapping[str, str]) -> list[str]:
    """The block below the title of a release that is not the benchmark."""
    if not is_own(provenance):
        return []
    return [
        f"> **This is not the PlaceBench benchmark.** The pipeline of PlaceBench made it from catalogue `{provenance['catalogue']}`"
        f" (SHA-256 `{provenance['catalogue_hash'][:12]}`) with recipe `{provenance['recipe']}` (`{provenance['recipe_hash'][:12]}`)."
        " Its version is that of the format. Figures of PlaceBench, and of the paper, are of other objects and may not be compared with"
        " figures of these data."
    ]


def citation_of(citation: Citation, provenance: Mapping[str, str]) -> Citation:
    """How a release is cited: one of one's own has no DOI, date or author that this code knows."""
    if not is_own(provenance):
        return citation
    work = Work(f"Dataset of {provenance['catalogue']}, made with the pipeline of PlaceBench", ("whoever made it",))
    return replace(citation, work=work, abstract=ABSTRACT_OF_OWN, doi=None, key="own_dataset", has_date=False)
