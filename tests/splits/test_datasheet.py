"""The datasheet answers from the data, and CITATION.cff says the same as the code and the card."""

from __future__ import annotations

import re
from pathlib import Path

import pyarrow as pa
import pytest
import yaml

from splits.citation import CITATION_FILE, load_citation
from splits.data_card import PAPER_CITATION
from splits.errors import ReleaseError
from splits.manifest import DATA_VERSION, DATASHEET, LICENCE
from splits.release import write_release
from splits.summary import summary_of
from tables import schemas
from tables.store import table_from_rows
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE

SECTIONS = ["Motivation", "Composition", "Collection process", "Preprocessing, cleaning, labelling", "Uses", "Distribution", "Maintenance"]


def test_every_section_is_answered(release: Path) -> None:
    text = (release / DATASHEET).read_text(encoding="utf-8")
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == SECTIONS
    questions = re.findall(r"^\*\*(.+\?)\*\*\n\n(.+)$", text, re.MULTILINE)
    assert len(questions) >= 35
    assert all(len(answer) > 3 for _, answer in questions)
    assert len({question for question, _ in questions}) == len(questions)


def test_its_numbers_are_those_of_the_tables(release: Path, release_tables: dict[str, pa.Table]) -> None:
    text = (release / DATASHEET).read_text(encoding="utf-8")
    for name, table in release_tables.items():
        assert re.search(rf"^\| `{name}` \| .* \| {table.num_rows:,} \|$", text, re.MULTILINE), name
    rows = [row for row in release_tables["candidates"].to_pylist() if row["category"] == "mug"]
    n_scenes = sum(row["category"] == "mug" for row in release_tables["scenes"].to_pylist())
    planned, valid = (100 * sum(map(bool, values)) / len(rows) for values in zip(*((row["y_plan"], row["y_pipe"]) for row in rows)))
    assert f"| mug | {n_scenes} | {len(rows)} | {planned:.1f} % | {valid:.1f} % |" in text
    lifted = sum(row["lift_status"] == "lifted" for row in release_tables["grasps"].to_pylist())
    assert f"{lifted} of those lifted the object" in text
    assert "This release holds no repeats of its labels." in text


def test_other_data_make_another_datasheet(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    scene_id = release_tables["candidates"]["scene_id"][0].as_py()
    rows = [row for row in release_tables["candidates"].to_pylist() if row["scene_id"] == scene_id and row["y_plan"]]
    repeats = [
        {
            "candidate_id": row["candidate_id"],
            "perturbation": "half_step",
            "repeat": 0,
            "plan_status": "solved",
            "exec_status": row["exec_status"] if k else ("off_target" if row["y_pipe"] else "success"),
            "final_position_error_m": 0.0,
            "final_rotation_error_rad": 0.0,
            "plan_matches": True,
            "exec_matches": bool(k),
            "is_identical": False,
        }
        for k, row in enumerate(rows)
    ]
    fresh = [{**row, "perturbation": "fresh_process", "is_identical": k == 0} for k, row in enumerate(repeats[:2])]
    tables = release_tables | {"attempts": table_from_rows(schemas.ATTEMPTS, repeats + fresh)}
    summary = summary_of(tables)
    assert (summary.n_identical, summary.n_repeats) == (1, 2)
    assert (summary.n_flips, summary.n_attempts) == (1, len(rows))
    write_release(tables, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    text = (tmp_path / DATASHEET).read_text(encoding="utf-8")
    assert "1 of 2 repeats in a fresh process are the same" in text
    assert f"1 ({100 / len(rows):.1f} %) of {len(rows)} executions under a changed simulation" in text
    assert text != (release / DATASHEET).read_text(encoding="utf-8")


def test_the_citation_fits_the_code() -> None:
    citation, content = load_citation(), yaml.safe_load(CITATION_FILE.read_text(encoding="utf-8"))
    assert citation.version == DATA_VERSION
    assert (content["cff-version"], content["type"], content["license"]) == ("1.2.0", "dataset", LICENCE)
    assert content["message"]
    paper = citation.protocol
    assert paper.title in PAPER_CITATION
    family_names = [author["family-names"] for author in content["references"][0]["authors"]]
    assert re.findall(r"(\w+), \w+", PAPER_CITATION.split("author")[1].split("note")[0]) == family_names
    # What the schema of CFF 1.2.0 demands and allows of a file like this one.
    assert {"cff-version", "message", "title", "authors"} <= content.keys()
    allowed = {"abstract", "type", "version", "date-released", "license", "keywords", "doi", "references"}
    assert content.keys() <= allowed | {"cff-version", "message", "title", "authors"}


def test_card_and_datasheet_cite_the_data_and_the_paper(release: Path) -> None:
    for name in ("README.md", DATASHEET):
        text = (release / name).read_text(encoding="utf-8")
        assert PAPER_CITATION in text
        assert load_citation().bibtex("pilot", "0.1.0") in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(doi="10.5281/zenodo.123"), ""),
        (lambda c: c.update(doi="https://doi.org/10.5281/zenodo.123"), "doi .*must be 10.<registrant>/<name>"),
        (lambda c: c.update(version="one"), "version 'one', must be major.minor.patch"),
        (lambda c: c.update({"date-released": "soon"}), "date-released 'soon', must be year-month-day"),
        (lambda c: c.pop("authors"), "cannot be read as a citation: 'authors'"),
        (lambda c: c.update(authors=[]), r"authors \[\], must both be given"),
    ],
    ids=["a doi", "a url for a doi", "a version", "a date", "no authors", "nobody"],
)
def test_a_citation_is_checked(tmp_path: Path, change, message: str) -> None:
    content = yaml.safe_load(CITATION_FILE.read_text(encoding="utf-8"))
    change(content)
    (tmp_path / "CITATION.cff").write_text(yaml.safe_dump(content))
    if message:
        with pytest.raises(ReleaseError, match=message):
            load_citation(tmp_path / "CITATION.cff")
    else:
        citation = load_citation(tmp_path / "CITATION.cff")
        assert citation.url == "https://doi.org/10.5281/zenodo.123"
        assert "doi     = {10.5281/zenodo.123}" in citation.bibtex("full", citation.version)
