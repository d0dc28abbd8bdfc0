"""What the data card says of the split schemes beside the paper's: who is held out and how large each part is, taken from the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import polars as pl

from splits.markdown import MISSING, count, percent, share, table
from splits.schemes import APPENDED_CLASS, not_applying, size_classes
from tables.vocabulary import Allocation, Split, SplitScheme

_SCHEMES = [scheme for scheme in SplitScheme if scheme is not SplitScheme.SCENE]

_ABOUT = """Table `splits` has {n} more columns, each another way to hold scene groups out. After the join of the queries below,
`candidates.filter(pl.col("{example}") == "train")` is the training set of one of them.

- `split_object`: unseen objects. A size class is the smaller or the larger half of a category by the volume of the box around an object
  (`size_x_m` times `size_y_m` times `size_z_m` in `objects`); of each class one object is in test alone and one in validation alone.
- `split_category_<name>`: an unseen category, three rotations: train on two, test on all scenes of the third.
- `split_layout`: more clutter. Test has all scenes with two obstacles. Regions of targets are not held out: the targets of a scene lie
  all over the table, and a scene group is never split.

What `split_category_<name>` and `split_layout` do not hold out is in validation where `split` has it in validation, and else in train. A
ranker that was trained under a column may be judged on the test scenes of that column only: it may have seen those of another.
Rates differ between the parts because what is held out is easier or harder to place; compare policies within a part."""


_ABOUT_APPENDED = f"""
Here, in a catalogue that grows, a size class is {APPENDED_CLASS} objects in file order instead, and `split` deals the scenes of every
object by themselves: another object, appended to the catalogue, changes no part of these."""


def scheme_section(frames: Mapping[str, pl.DataFrame], joined: pl.DataFrame, provenance: Mapping[str, str]) -> str:
    """Markdown of the section.

    Args:
        frames: `splits`, `scenes` and `objects`.
        joined: candidates with every column of `splits` and their `success`.
        provenance: of the release.
    """
    is_appended = provenance.get("allocation") == Allocation.APPENDED
    without = not_applying(dict(frames["objects"].select("object_id", "category").iter_rows()))
    schemes = [scheme for scheme in _SCHEMES if scheme not in without]
    scenes = frames["splits"].join(frames["scenes"].select("scene_id", "object_id", "category", "n_obstacles"), on="scene_id")
    about = _ABOUT.format(n=len(_SCHEMES), example=SplitScheme.OBJECT.column) + (_ABOUT_APPENDED if is_appended else "")
    blocks = ["## More splits", about, _sizes(scenes, joined, schemes), _emptiness(scenes, schemes)]
    if without:
        reasons = "; ".join(f"`{scheme.column}`: {reason}" for scheme, reason in without.items())
        blocks.append(f"Of no use here: {reasons}.")
    blocks += [] if is_appended else [_objects(scenes, frames["objects"])]
    return "\n\n".join(blocks)


def _sizes(scenes: pl.DataFrame, joined: pl.DataFrame, schemes: Sequence[SplitScheme]) -> str:
    rows = []
    for scheme in schemes:
        for split in Split:
            own, candidates = (frame.filter(pl.col(scheme.column) == split.value) for frame in (scenes, joined))
            rates = [candidates[name].mean() if candidates.height else None for name in ("y_plan", "success")]
            cells = [", ".join(own["category"].unique().sort()) or None, ", ".join(map(str, own["n_obstacles"].unique().sort())) or None]
            sizes = [share(own.height, scenes.height), count(own["object_id"].n_unique()), share(candidates.height, joined.height)]
            rows.append([f"`{scheme.column}`", split.value, *sizes, *(percent(rate) for rate in rates), *cells])  # type: ignore[arg-type]
    header = ["column", "split", "joint groups", "objects", "candidates", "planned", "success", "categories", "obstacles"]
    return table(header, rows, align="llrrrrrll")


def _emptiness(scenes: pl.DataFrame, schemes: Sequence[SplitScheme]) -> str:
    empty = [f"`{s.column}` {split.value}" for s in schemes for split in Split if not (scenes[s.column] == split.value).any()]
    if not empty:
        return "No part is empty in this tier."
    return f"**Empty in this tier: {', '.join(empty)}.** A scene keeps its split in every tier: use a larger one for these columns."


def _objects(scenes: pl.DataFrame, objects: pl.DataFrame) -> str:
    """Objects by size class and by their split under scheme `object`; those without a scene in the tier have a column of their own."""
    column = SplitScheme.OBJECT.column
    part_of = dict(scenes.select("object_id", column).unique().iter_rows())
    volume_m3 = pl.col("size_x_m") * pl.col("size_y_m") * pl.col("size_z_m")
    sizes = {name: (of, volume) for name, of, volume in objects.select("object_id", "category", volume_m3.alias("v")).iter_rows()}
    rows = []
    for (category, name), members in size_classes(sizes).items():
        litres = [1e3 * sizes[object_id][1] for object_id in members]
        by_part = [[m for m in members if part_of.get(m) == part] for part in (*(split.value for split in Split), None)]
        bounds = f"{min(litres):.2f} to {max(litres):.2f}" if litres else MISSING
        rows.append([f"{name} {category}", bounds, *(", ".join(f"`{m}`" for m in own) or None for own in by_part)])
    header = [f"`{column}`: size class", "box in litres", *(split.value for split in Split), "no scene in this tier"]
    return table(header, rows, align="lrllll")
