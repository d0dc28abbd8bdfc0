"""The command on the small dataset: every key is in the report, a tier of other origin is refused, and a second run measures nothing."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest
from rich.console import Console

from assets_def.validity import report_path, validity
from pipelines.decoded import Decoded
from pipelines.proofs.validity.criteria import BESIDE, CRITERIA, measured_by
from pipelines.proofs.validity.flips import flips_study
from pipelines.proofs.validity.pull_out import torsion_study
from pipelines.proofs.validity.studies import STUDIES, numbers_of, run_studies
from pipelines.proofs.validity.subject import Sizes, Subject
from reports.validity import validity_report
from splits.errors import ReleaseError
from splits.release_reader import Release
from tests.assets_def.conftest import Built

SIZES = Sizes(n_grasps=1, n_grasps_elsewhere=1, n_flat=1, n_loads=6, n_executions=2, n_friction=2, n_lifts=2, n_second_engine=2)
QUIET = Console(quiet=True)
# Others read the file by these names.
KEYS = {
    "hold_creep_mm_median", "hold_creep_mm_max", "pullout_ratio_min", "pullout_ratio_max", "torsion_lever_ratio_min",
    "torsion_lever_ratio_max", "transport_slip_mm_max", "light_load_drops", "cuboid_auc", "half_step_flip", "friction_flip",
    "friction_right_way", "finer_pad_flip", "engine2_agreement", "engine2_kappa", "solver_faults",
}  # fmt: skip
COUNTS = {
    "n_hold_creep", "n_pullout", "n_torsion", "n_transport_slip", "n_light_load", "n_cuboid_auc", "n_half_step", "n_friction",
    "n_friction_flipped", "n_finer_pad", "n_engine2", "n_solver_faults",
}  # fmt: skip


def test_every_number_is_in_the_files_and_a_second_run_measures_nothing(
    built: Built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    benchmark = built.copy(tmp_path)
    first = validity("mini", benchmark, SIZES, QUIET)
    written = json.loads((tmp_path / "reports" / "validity.json").read_text())
    assert set(written) == {name for criterion in (*CRITERIA, *BESIDE) for name in (criterion.key, criterion.count_key)}
    assert {criterion.key for criterion in CRITERIA} == KEYS
    assert {criterion.count_key for criterion in CRITERIA} == COUNTS
    # Numbers that a sample of this size can tell are within their bounds; the others are null or shown with their count.
    told = KEYS - {"cuboid_auc"}
    for criterion in CRITERIA:
        if criterion.key in told:
            assert math.isfinite(written[criterion.key]), criterion.key
            assert criterion.holds(written[criterion.key]), criterion.key
    assert (written["stored_differs"], written["n_stored"]) == (0.0, 2.0)
    assert (written["lift_stored_differs"], written["n_lift_stored"]) == (0.0, 2.0)
    assert written["n_solver_faults"] > written["n_half_step"]

    text = (tmp_path / "reports" / "validity.md").read_text()
    for criterion in (*CRITERIA, *BESIDE):
        assert f"`{criterion.key}`" in text
    for fact in ("`42`", "`mini`", benchmark.recipe_of_tier("mini").hash_of()):
        assert fact in text

    def never(*arguments: object) -> None:
        raise AssertionError("measured again, although nothing changed")

    monkeypatch.setattr("pipelines.proofs.validity.running.measured", never)
    assert validity("mini", benchmark, SIZES, QUIET).numbers == first.numbers

    # Some studies are a report of their own, which says what it leaves out; the whole one stays.
    text = (tmp_path / "reports" / "validity.md").read_text()
    partial = validity("mini", benchmark, SIZES, QUIET, only=("torsion", "second_engine"))
    assert partial.holds
    assert report_path("mini", benchmark, ("second_engine", "torsion")) == tmp_path / "reports" / "validity-mini-torsion+second_engine.md"
    own = json.loads((tmp_path / "reports" / "validity-mini-torsion+second_engine.json").read_text())
    assert own.pop("left_out") == ["hold_creep", "hold_creep_elsewhere", "pull_out", "loads", "flips", "lifts"]
    criteria = measured_by((*CRITERIA, *BESIDE), ("torsion", "second_engine"))
    assert own.keys() == {name for criterion in criteria for name in (criterion.key, criterion.count_key)}
    assert {key: value for key, value in own.items() if not key.endswith("solver_faults")}.items() < written.items()
    assert own["n_solver_faults"] < written["n_solver_faults"]
    told = (tmp_path / "reports" / "validity-mini-torsion+second_engine.md").read_text()
    assert "5 of 5 numbers of these studies are within their bounds" in told
    untested = {criterion.key for criterion in CRITERIA} - own.keys()
    claims = [line for line in told.splitlines() if any(f"`{key}`" in line for key in untested)]
    assert len(untested) == 11
    assert [line.startswith("> **A partial run.**") for line in claims] == [True]
    assert (tmp_path / "reports" / "validity.md").read_text() == text


def test_a_release_of_another_recipe_is_refused(built: Built, tmp_path: Path) -> None:
    benchmark = built.copy(tmp_path)
    (tmp_path / "recipe.toml").write_text("[grasp_admission]\nquota = 3\n")
    with pytest.raises(ReleaseError, match=r"release mini: made with recipe \w{12}, must be today's \w{12}"):
        validity("mini", benchmark, SIZES, QUIET)


def test_studies_have_their_names_and_every_number_has_its_study(built: Built, tmp_path: Path) -> None:
    benchmark = built.copy(tmp_path)
    release, recipe = Release.open(benchmark.root.release("mini")), benchmark.recipe_of_tier("mini")
    subject = Subject(release.values, release.table("candidates"), recipe, SIZES)
    assert [maker(subject).name for maker in STUDIES.values()] == list(STUDIES)
    assert {criterion.study for criterion in (*CRITERIA, *BESIDE)} == {*STUDIES, ""}


@pytest.mark.parametrize(("tier", "n"), [("mini", 150), ("pilot", 150), ("full", 300)])
def test_full_asks_the_second_engine_twice_as_often_and_nothing_else_more(tier: str, n: int) -> None:
    assert dataclasses.replace(Sizes.of_tier(tier), n_second_engine=150) == Sizes()
    assert Sizes.of_tier(tier).n_second_engine == n


def test_a_study_that_cannot_be_made_is_in_the_report(built: Built, tmp_path: Path) -> None:
    """A release without its plans: what needs them is named as not measured, with the reason."""
    benchmark = built.copy(tmp_path)
    release, recipe = Release.open(benchmark.root.release("mini")), benchmark.recipe_of_tier("mini")
    tables = {name: release.table(name) for name in release.manifest.tables if name != "plans"}
    subject = Subject(Decoded(tables), release.table("candidates"), recipe, SIZES)
    results = run_studies(subject, tmp_path / "rows", {}, 0, makers={"flips": flips_study, "torsion": torsion_study})
    numbers = numbers_of(results, subject)
    report = validity_report(numbers, results, {"tier": "mini"})
    assert not report.holds
    assert (numbers["half_step_flip"], numbers["n_half_step"]) == (None, 0.0)
    assert numbers["torsion_lever_ratio_max"] is not None
    assert "- study `flips`: KeyError: 'plans'" in report.markdown
    assert json.loads(report.json)["half_step_flip"] is None
