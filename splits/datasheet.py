"""The datasheet of a release, by the questions of Gebru et al. (Datasheets for Datasets, CACM 64(12), 2021), answered from its tables.

Questions about people do not arise and are answered once. Every number is counted or read from the manifest.
"""

from __future__ import annotations

from splits.citation import Citation
from splits.data_card import PAPER_CITATION, limits
from splits.manifest import CARD, CROISSANT, MANIFEST, Manifest
from splits.markdown import count, percent, table
from splits.own import LICENCE_OF_OWN, column_meaning, notice_of, table_meaning, title_of
from splits.provenance import is_own
from splits.statements import (
    CLEANING,
    MAINTENANCE,
    MISSING,
    MISUSES,
    OWN_PURPOSE,
    PURPOSE,
    SENSITIVE,
    SOCIAL_IMPACT,
    USES,
    biases,
    label_checks,
    labelled_how,
    made_how,
)
from splits.summary import Part, Summary
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES, SPLITS

Answers = list[tuple[str, str]]


def render_datasheet(manifest: Manifest, summary: Summary, citation: Citation) -> str:
    """Markdown of the datasheet.

    Args:
        manifest: of the release; its entries of texts are not looked at.
        summary: counts in its tables.
        citation: how the data are cited; see `own.citation_of`.
    """
    sections = {
        "Motivation": _motivation(manifest, citation),
        "Composition": _composition(manifest, summary),
        "Collection process": _collection(manifest, summary),
        "Preprocessing, cleaning, labelling": _labelling(summary),
        "Uses": _uses(manifest, summary),
        "Distribution": _distribution(manifest, citation),
        "Maintenance": _maintenance(manifest, citation),
    }
    blocks = [
        f"# Datasheet of {title_of(manifest.provenance, manifest.tier, manifest.version)}",
        *notice_of(manifest.provenance),
        "After Gebru et al., *Datasheets for Datasets*, Communications of the ACM 64(12), 2021. Rendered from the release"
        f" `{manifest.release_hash}`; the data card, `{CARD}`, explains the words and every column.",
    ]
    for title, answers in sections.items():
        blocks.append(f"## {title}")
        blocks += [f"**{question}**\n\n{answer}" for question, answer in answers]
    return "\n\n".join(blocks) + "\n"


def _motivation(manifest: Manifest, citation: Citation) -> Answers:
    return [
        ("For what purpose was the dataset created?", OWN_PURPOSE if is_own(manifest.provenance) else PURPOSE),
        ("Who created the dataset and on behalf of which entity?", f"{' and '.join(citation.work.authors)}; no other entity is recorded."),
        ("Who funded the creation of the dataset?", "No funding is recorded. It takes ordinary processors and open software."),
    ]


def _composition(manifest: Manifest, summary: Summary) -> Answers:
    about = manifest.provenance
    rows = [[f"`{name}`", table_meaning(ALL_SCHEMAS[name], about), count(entry.rows)] for name, entry in sorted(manifest.tables.items())]
    instances = table(["table", "one row is", "rows"], rows, align="llr")
    heavy = [name for name in sorted(manifest.tables) if name in HEAVY_TABLES]
    return [
        (
            "What do the instances represent?",
            "A candidate is a pair of a grasp and a placement target of one scene, with two labels. Other tables hold what it refers to.",
        ),
        ("How many instances are there in total?", instances),
        (
            "Is it all possible instances or a sample of a larger set?",
            f"Scenes are random draws of what the recipe allows; in the {count(summary.whole.n_scenes)} scenes here every lifted grasp is"
            " paired with every target. Tiers are nested: the scenes of `pilot` are scenes of `full`, with the same ids and the same rows.",
        ),
        (
            "What data does each instance consist of?",
            f"Scalars with units in their names, and flat lists in meshes and plans; no images. `{CROISSANT}` lists every column.",
        ),
        ("Is there a label or target associated with each instance?", _items(labelled_how())),
        ("How often is each label true?", _shares(summary)),
        ("Is any information missing from individual instances?", MISSING),
        (
            "Are relationships between instances explicit?",
            "Yes: ids of scene, target, grasp and object are the keys that tables share. Candidates of one scene are not independent.",
        ),
        (
            "Are there recommended data splits?",
            "Scenes are held out whole. Table `splits` says where each belongs, and the files of `candidates` are divided by its column"
            " `split`. Its columns:\n\n"
            + _items([f"`{column.name}`: {column_meaning(column, about)}" for column in SPLITS.columns if column.name not in SPLITS.key]),
        ),
        ("Are there errors, sources of noise or redundancies?", label_checks(summary)),
        (
            "Is the dataset self-contained?",
            f"Yes. A light release leaves out {_code(heavy)} under the same manifest; all but `timings` are made again from what it holds."
            if heavy
            else "Yes.",
        ),
        ("Does it contain confidential, offensive or personal data, or data about people?", SENSITIVE),
    ]


def _collection(manifest: Manifest, summary: Summary) -> Answers:
    versions = ", ".join(f"{name} {version}" for name, version in sorted(manifest.libraries.items()))
    origin = [f"`{name}` `{value}`" for name, value in sorted(manifest.provenance.items()) if not name.startswith("code.")]
    return [
        ("How was the data acquired?", made_how(summary)),
        ("What mechanisms were used, and how were they validated?", f"{versions}. {label_checks(summary)}"),
        ("What identifies the making?", _items(origin)),
        (
            "If the dataset is a sample, what was the sampling strategy?",
            "Every draw comes from a hash of the recipe's seed and an id, never from order, process or time. Draws that were redrawn are"
            " in `scene_attempts`, with the reason.",
        ),
        ("Who was involved in the collection, and how were they compensated?", "Nobody: programs made every row."),
        ("Over what time was the data collected?", "It does not depend on time: the same code and recipe make the same rows on any day."),
        ("Were ethical review processes conducted?", "No; there are no human or animal subjects."),
    ]


def _labelling(summary: Summary) -> Answers:
    return [
        ("Was any preprocessing, cleaning or labelling done?", f"{CLEANING} Labels are computed: {' '.join(labelled_how())}"),
        ("Was the raw data saved?", "There is none beyond the tables; measured quantities behind the labels are columns."),
        (
            "Is the software available?",
            "Yes, all of it, under Apache-2.0; commit and recipe are named above. `python -m pipelines.regenerate` makes a row again.",
        ),
    ]


def _uses(manifest: Manifest, summary: Summary) -> Answers:
    return [
        (
            "Has the dataset been used for any tasks already?",
            "For the baselines and the ranker of the reports that were rendered with it."
            if is_own(manifest.provenance)
            else "For the baselines and the ranker whose reports the repository renders.",
        ),
        ("What tasks could it be used for?", _items(USES)),
        ("What about its composition might affect future uses?", _items(biases(summary, manifest.provenance))),
        ("What are its limits?", _items(limits(manifest.provenance))),
        ("Are there tasks for which it should not be used?", _items(MISUSES)),
        ("What impact might uses have on people?", SOCIAL_IMPACT),
    ]


def _distribution(manifest: Manifest, citation: Citation) -> Answers:
    where = f"Under {citation.url}." if citation.url else "With the code of PlaceBench; no DOI was given to it when this was rendered."
    when = f"Version {citation.version} on {citation.date}; this is version {manifest.version}."
    licence = f"{manifest.licence}. No third party restricts it; meshes are the catalogue's own solids."
    if is_own(manifest.provenance):
        where = when = "That is for whoever made it to say."
        licence = f"That is {LICENCE_OF_OWN}; `object_meshes` holds the geometry of the catalogue's mesh files."
    return [
        ("Will the dataset be distributed to third parties, and how?", where),
        ("When?", when),
        ("Under which licence?", licence),
        ("How is it cited?", f"```bibtex\n{citation.bibtex(manifest.tier, manifest.version)}\n\n{PAPER_CITATION}\n```"),
        ("Do export controls or other restrictions apply?", "None are known."),
    ]


def _maintenance(manifest: Manifest, citation: Citation) -> Answers:
    return [
        (
            "Who maintains the dataset, and how can they be contacted?",
            f"{' and '.join(citation.work.authors)}{'' if is_own(manifest.provenance) else ', by issues of the repository'}.",
        ),
        ("Will it be updated, and will older versions be kept?", MAINTENANCE),
        (
            "Is there an erratum?",
            "None is known." if is_own(manifest.provenance) else "CHANGELOG.md of the repository, section Data.",
        ),
        (
            "How does somebody check a copy?",
            f"`python -m splits.release verify DIR` compares every file with `{MANIFEST}`, every value with its schema, labels and splits"
            " with their laws, and this text with the data.",
        ),
        (
            "Can others extend it?",
            "Yes: stages, objects and recipes are made to be added to; what is released then needs a name of its own.",
        ),
    ]


def _shares(summary: Summary) -> str:
    parts = {**summary.by_split, **summary.by_category, "all": summary.whole}
    lines = [[name, count(part.n_scenes), count(part.n_candidates), *_rates(part)] for name, part in parts.items()]
    return table(["of", "scenes", "candidates", "planned", "success"], lines)


def _rates(part: Part) -> list[str]:
    return [percent(n / part.n_candidates if part.n_candidates else None) for n in (part.n_planned, part.n_valid)]


def _items(texts: tuple[str, ...] | list[str]) -> str:
    return "\n".join(f"- {text}" for text in texts)


def _code(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)
