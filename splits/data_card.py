"""The README of a release, rendered from its tables so that no number in it can be stale; release.py writes it."""

from __future__ import annotations

import re
from collections.abc import Mapping

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from splits.citation import Citation
from splits.confidence import confidence_section
from splits.examples import examples_section
from splits.hub_card import READING, front_matter
from splits.markdown import count, percent, share, table
from splits.own import FRICTION_OF_OWN, KNOWN_OBJECTS_OF_OWN, LICENCE_OF_OWN, column_meaning, notice_of, table_meaning, title_of
from splits.provenance import is_own
from splits.scheme_section import scheme_section
from tables.columns import TableSchema
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES
from tables.vocabulary import Category, ExecStatus, PlanStatus, Split

PAPER_CITATION = """@misc{liu_execution_aware_ranking,
  title  = {Execution-Aware Pre-Execution Ranking for Grasp-Conditioned Robotic Placement},
  author = {Liu, Tianyuan and Patamia, Rutherford Agbeshi and Champion, Benjamin and Dazeley, Richard and Cosgun, Akansel},
  note   = {Deakin University}
}"""

_KNOWN_OBJECTS = """\
- **Known objects.** Column `split` holds out scenes, not objects: an object may occur in all of its parts, and results on it say nothing
  about unseen objects. `split_object` and `split_category_<name>` are for that, over 30 objects of three categories and no more."""

_FRICTION = """\
friction (0.32 between pads and printed metal) and the stiffness of the pads are chosen within the
  bounds of sources that the catalogue and the engine's parameters name"""

_LIMITS = """\
- **A protocol, not the paper's labels.** The protocol is that of the paper cited below, which used Isaac Sim and cuMotion; here it is
  MuJoCo (held objects), PyBullet (resting ones), OMPL, pinocchio and coal. Rates differ and may not be compared as if they were of the
  same data.
- **What the hand holds.** Pick-lift and execution are simulated in MuJoCo in the frame of the hand. A pad is its real face of
  17.5 x 18.5 mm in 3 x 3 cells that yield and hold the torque of even pressure: a lever of 6.9 mm about the jaw axis on a flat face, less
  on a line of contact. A finger presses with 50 N, the middle of what the Franka Hand holds continuously, and moves at 0.05 m/s.
  Cans are exact cylinders there; {friction}. Force, friction and lever decide which grasps slip: `attempts` has
  executions with the lever 15 % longer and shorter. The links of the arm do not collide there; the planner keeps them clear, and the
  path audit checks it in a second engine.
- **Simulation only.** Rigid bodies, Coulomb friction, convex parts instead of exact meshes. No label was confirmed on a robot.
- **Labels near the tolerance are chaotic.** Contact dynamics amplify differences that mean nothing physically; the section on how sure
  the labels are says by how much.
{known_objects}
- **Supervision only.** Whatever is known only after planning or physics must not be a model input: the columns of `candidates` from
  `y_plan` on, `plans`, and the lifted and in-hand states in `grasps`.
- **One grasp and one placement.** Regrasping, stacking and moving obstacles are not in the data."""

_INTRODUCTION = """Grasp-conditioned placement: every row of `candidates` pairs a grasp with a placement target of one scene and says
whether a motion planner found a complete placement motion (`y_plan`) and whether that motion, executed in physics, ended in a valid final
pose without a slip in the hand (`y_pipe`). A candidate is a success when both hold. The task is to order the candidates of a group, before
anything is planned, so that a success comes first."""

_ABOUT_OUTCOMES = """An executed placement ends *valid* when nothing was dropped or driven into something, no protective stop ended it, and
the object came to rest within the position and rotation of `tolerances`, modulo its symmetry. A valid end is a `success` when the object
moved in the hand by no more than the slip of `tolerances` before release, and `slipped_in_hand` when it moved more; every other status
says why the end is not valid, whether the object slipped or not. The label of the paper cited below, a valid end whatever the slip, is
`exec_status` in (`success`, `slipped_in_hand`)."""

_ABOUT_SPLITS = """Scene groups are held out whole, stratified by category and obstacle count; a scene keeps its split in every tier. A
group is *covered* when it holds a success. Joint groups are scenes, fixed-target groups are one target of a scene; a group without a
lifted grasp counts as uncovered."""

_ABOUT_TABLES = """Poses are seven columns: metres and a unit quaternion xyzw; the prefix names the pose. Everything is in the robot base
frame (z up, table top at z = 0) unless its meaning says otherwise. `timings` were measured once, `attempts` were made from the release:
both are no part of the release hash."""

_ABOUT_SIZE = """A *light* release is this folder without its heavy tables (`python -m splits.release light WHOLE LIGHT`). Its manifest is
the same, so the hash of every table is known; `python -m splits.release verify --light` accepts that they are missing and nothing else.
From a light release and the code of the same recipe, `python -m splits.rebuild` makes them again in minutes (points are rendered, motions
planned, scenes sampled) and adds a table only if all its values have the listed hash. `timings` were measured: nothing makes them again.

All tables are lossless but one: the points of `scene_points` lie on a grid of 1/8192 m, 0.06 mm from where the renderer saw them at most,
beside pixels 3 mm apart. Measured label columns stay 64 bits wide: as 32-bit numbers they would save a tenth of a light release, and the
last bit is what shows that physics repeats itself. `candidates` and `grasps` hold what the stages' own tables do, which are not shipped;
the hand pose of every pool grasp in `grasps`, a third of that table, follows from the object's pose and `grasp_pool`, and stays because
rankers read it."""

_CHECKING = """`python -m splits.release verify DIR` recomputes every checksum, checks every schema, and looks for impossible labels, for
leaks between splits and for files that do not belong here. `manifest.json` was written last: without it a release is not complete. It
lists size and SHA-256 of every other file, and in `manifest_sha256` the SHA-256 of its own other fields."""


def limits(provenance: Mapping[str, str]) -> list[str]:
    """The limits as single paragraphs without Markdown, each beginning with its title, for texts of another form."""
    items = re.split(r"^- ", _limits(provenance), flags=re.MULTILINE)[1:]
    return [" ".join(item.replace("**", "").replace("`", "").split()) for item in items]


def _limits(provenance: Mapping[str, str]) -> str:
    own = is_own(provenance)
    return _LIMITS.format(known_objects=KNOWN_OBJECTS_OF_OWN if own else _KNOWN_OBJECTS, friction=FRICTION_OF_OWN if own else _FRICTION)


def render_card(
    tables: Mapping[str, pa.Table], facts: Mapping[str, str], rows: Mapping[str, int], sizes: Mapping[str, int], citation: Citation
) -> str:
    """Markdown of the data card.

    Args:
        tables: tables of the release by name; heavy ones are not looked at.
        facts: what the tables do not say: `tier`, `version`, `schema_version`, `licence`, `release_hash`, `scenes_of_tier`, provenance.
        rows: rows of each table.
        sizes: bytes of the files of each table.
        citation: how the data are cited; see `own.citation_of`.
    """
    frames = {name: frame_of(tables[name]) for name in ("candidates", "splits", "scenes", "targets", "grasps", "objects")}
    joined = frames["candidates"].join(frames["splits"], on="scene_id").with_columns(pl.col("y_pipe").fill_null(False).alias("success"))
    own = citation.bibtex(facts["tier"], facts["version"])
    licence = LICENCE_OF_OWN if is_own(facts) else facts["licence"]
    terms = "The licence of the data is" if is_own(facts) else "The data are licensed under"
    licence_and_citation = (
        f"{terms} {licence}. Cite them as\n\n```bibtex\n{own}\n```\n\nand the paper whose protocol is theirs:"
        f"\n\n```bibtex\n{PAPER_CITATION}\n```\n\n"
        "`DATASHEET.md` answers the questions of a datasheet; `croissant.json` describes every column for machines."
    )
    blocks = [
        front_matter(rows, dict(joined["split"].value_counts().iter_rows()), facts),
        f"# {title_of(facts, facts['tier'], facts['version'])}",
        *notice_of(facts),
        _INTRODUCTION,
        _facts(frames, facts, licence),
        f"## Splits\n\n{_ABOUT_SPLITS}",
        _splits(frames, joined),
        scheme_section(frames, joined, facts),
        f"## Outcomes\n\n{_ABOUT_OUTCOMES}",
        _outcomes(joined),
        "## Scenes",
        _scenes(frames["scenes"]),
        f"## How to read it\n\n{READING}",
        "## Look at a candidate",
        examples_section(frames["candidates"], int(facts.get("recipe_seed", "42")), is_own=is_own(facts)),
        "## How sure the labels are",
        confidence_section(frames["candidates"], frame_of(tables["attempts"]) if "attempts" in tables else None),
        "## Tables",
        _overview(rows, sizes, facts),
        _ABOUT_TABLES,
        "## Size, and the light release",
        _light(rows, sizes),
        _ABOUT_SIZE,
        *(_schema(ALL_SCHEMAS[name], facts) for name in sorted(rows)),
        f"## Limits\n\n{_limits(facts)}",
        f"## Licence and citation\n\n{licence_and_citation}",
        f"## Checking it\n\n{_CHECKING}",
    ]
    return "\n\n".join(blocks) + "\n"


def _facts(frames: Mapping[str, pl.DataFrame], facts: Mapping[str, str], licence: str) -> str:
    n_scenes = frames["scenes"].height
    lines = [
        ("objects", f"{frames['scenes']['object_id'].n_unique()} of {frames['objects'].height} in the catalogue"),
        ("scenes", f"{count(n_scenes)} of {facts['scenes_of_tier']} in the tier"),
        ("targets", count(frames["targets"].height)),
        ("lifted grasps a scene", f"{(frames['grasps']['lift_status'] == 'lifted').sum() / max(1, n_scenes):.1f}"),
        ("candidates", count(frames["candidates"].height)),
        *(
            (f"`{name}`", f"`{value}`")
            for name, value in sorted(facts.items())
            if name not in ("tier", "version", "scenes_of_tier", "licence")
        ),
        ("licence", licence),
    ]
    return table(["fact", "value"], lines, align="ll")


def _splits(frames: Mapping[str, pl.DataFrame], joined: pl.DataFrame) -> str:
    rows = []
    n_all = joined.height
    for name in [*(split.value for split in Split), "all"]:
        chosen = frames["splits"] if name == "all" else frames["splits"].filter(pl.col("split") == name)
        own = joined if name == "all" else joined.filter(pl.col("split") == name)
        n_fixed = frames["targets"].join(chosen, on="scene_id").height
        covered = own.filter("success")
        rows.append(
            [
                name,
                count(chosen.height),
                share(own.height, n_all),
                percent(own["y_plan"].mean() if own.height else None),  # type: ignore[arg-type]
                percent(own["success"].mean() if own.height else None),  # type: ignore[arg-type]
                share(covered["scene_id"].n_unique(), chosen.height),
                count(n_fixed),
                share(covered.select("scene_id", "target_id").n_unique(), n_fixed),
            ]
        )
    return table(
        ["split", "joint groups", "candidates", "planned", "success", "covered joint", "fixed-target groups", "covered fixed"], rows
    )


def _outcomes(joined: pl.DataFrame) -> str:
    plans = _status_table(joined, "plan_status", [status.value for status in PlanStatus], "every candidate")
    executions = _status_table(joined.filter("y_plan"), "exec_status", [status.value for status in ExecStatus], "every planned candidate")
    return f"{plans}\n\n{executions}"


def _status_table(frame: pl.DataFrame, column: str, statuses: list[str], of: str) -> str:
    categories = [category.value for category in Category if (frame["category"] == category.value).any()]
    totals = {category: int((frame["category"] == category).sum()) for category in categories}
    counts = {(status, category): n for status, category, n in frame.group_by(column, "category").len().iter_rows()}
    rows = [
        [
            f"`{status}`",
            share(sum(counts.get((status, c), 0) for c in categories), frame.height),
            *(share(counts.get((status, c), 0), totals[c]) for c in categories),
        ]
        for status in statuses
    ]
    return table(
        [f"`{column}` of {of}", "all", *categories], [*rows, ["all", count(frame.height), *(count(totals[c]) for c in categories)]]
    )


def _scenes(scenes: pl.DataFrame) -> str:
    counts = {(category, n): rows for category, n, rows in scenes.group_by("category", "n_obstacles").len().iter_rows()}
    obstacle_counts = sorted({n for _, n in counts})
    categories = [category.value for category in Category if any(c == category.value for c, _ in counts)]
    rows = [[category, *(count(counts.get((category, n), 0)) for n in obstacle_counts)] for category in categories]
    return table(["scenes", *(f"{n} obstacles" if n != 1 else "1 obstacle" for n in obstacle_counts)], rows)


def _overview(rows: Mapping[str, int], sizes: Mapping[str, int], facts: Mapping[str, str]) -> str:
    schemas = [ALL_SCHEMAS[name] for name in sorted(rows)]
    lines = [[f"`{s.name}`", table_meaning(s, facts), ", ".join(s.key), count(rows[s.name]), _kilobytes(sizes[s.name])] for s in schemas]
    return table(["table", "one row is", "key", "rows", "kB"], lines, align="lllrr")


def _light(rows: Mapping[str, int], sizes: Mapping[str, int]) -> str:
    heavy = [name for name in sorted(rows) if name in HEAVY_TABLES]
    lines = [
        [f"`{name}`", _kilobytes(sizes[name]), f"`python -m splits.rebuild DIR {target}`" if (target := HEAVY_TABLES[name]) else "nothing"]
        for name in heavy
    ]
    total, n_candidates = sum(sizes[name] for name in rows if name not in HEAVY_TABLES), max(1, rows["candidates"])
    lines.append(["all others", _kilobytes(total), f"always there: {total / n_candidates:.0f} bytes a candidate"])
    return table(["table", "kB", "made again by"], lines, align="lrl")


def _kilobytes(n_bytes: int) -> str:
    return f"{n_bytes / 1e3:,.1f}"


def _schema(schema: TableSchema, facts: Mapping[str, str]) -> str:
    rows = [
        [
            f"`{column.name}`",
            str(column.dtype).replace("dictionary<values=string, indices=int16, ordered=0>", "string, dictionary"),
            column.unit,
            "yes" if column.nullable else "",
            column_meaning(column, facts).replace("<", "&lt;")
            + (f": {', '.join(f'`{value}`' for value in column.values)}" if column.values else ""),
        ]
        for column in schema.columns
    ]
    columns = table(["column", "type", "unit", "null", "meaning"], rows, align="lllll")
    return f"### `{schema.name}`: {table_meaning(schema, facts)}\n\n{columns}"
