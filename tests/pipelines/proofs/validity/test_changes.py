"""Executions and lifts again under changes: what a flip is, which way is right, how they are chosen; small samples within the bounds."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from pipelines.codecs import Row, admitted_grasps
from pipelines.grasps.admission import AdmissionParams, admission_rows
from pipelines.labels.planning import plan_of
from pipelines.proofs.validity.changes import FRICTION, Change, changed_physics
from pipelines.proofs.validity.criteria import CRITERIA
from pipelines.proofs.validity.flips import flips_row, flips_summary, goes_right_way
from pipelines.proofs.validity.lifts import CHANGES, LiftCase, lifts_row, lifts_summary
from pipelines.proofs.validity.loads import area_under_roc, loads_row, loads_summary
from pipelines.proofs.validity.subject import Case, Sizes, choose_mixed
from pipelines.recipe import Recipe
from tests.pipelines.engines.physics.lifted import lifted, scene_of
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model

RECIPE = Recipe()
BOUNDS = {criterion.key: criterion for criterion in CRITERIA}


def cases(name: str, n: int) -> list[Case]:
    planned = lifted(name).planned[:n]
    return [Case(lifted(name).object_model, candidate, plan_of(motion), RECIPE) for candidate, motion in planned]


def run(name: str, margin: float, change: Change = Change.NONE, stored: str = "success") -> Row:
    status = "success" if margin >= 0 else "off_target"
    row = {"candidate_id": name, "category": "can", "change": change.value, "stored_status": stored, "status": status}
    return {**row, "is_success": margin >= 0, "margin": margin, "slip_mm": 0.1}


def test_upright_placements_hold_under_every_change() -> None:
    """Three executions under seven physics: within the bounds that the whole study has to keep."""
    for name in ("can", "cuboid", "mug"):
        rows = [flips_row(case, "success", change) for case in cases(name, 1) for change in Change]
        numbers = flips_summary(rows)
        for key in ("half_step_flip", "friction_flip", "friction_right_way", "finer_pad_flip"):
            value = numbers[key]
            assert value is not None
            assert BOUNDS[key].holds(value), key
        assert (numbers["n_half_step"], numbers["n_friction"], numbers["n_finer_pad"]) == (1.0, 2.0, 1.0)
        # Changes are changes: ends differ in some digit, but with friction, which decides nothing about what sticks.
        ends = {row["margin"] for row in rows if row["change"] not in [change.value for change in FRICTION]}
        assert len(ends) == len(Change) - len(FRICTION)


def test_each_change_is_what_it_says() -> None:
    physics = {change: changed_physics(RECIPE, change) for change in Change}
    base = RECIPE.hand_physics
    assert physics[Change.NONE] == base
    assert physics[Change.HALF_STEP].step_s == pytest.approx(base.step_s / 2)
    assert [physics[change].friction_scale for change in (Change.FRICTION_UP, Change.FRICTION_DOWN)] == [1.05, 0.95]
    assert physics[Change.FINER_PADS].cells_per_side == 5 != base.cells_per_side
    assert [physics[change].pad_lever_scale for change in (Change.LEVER_UP, Change.LEVER_DOWN)] == [1.15, 0.85]
    assert len(set(map(str, physics.values()))) == len(Change)


def test_flips_count_against_the_run_without_a_change() -> None:
    up, down = Change.FRICTION_UP, Change.FRICTION_DOWN
    rows = [
        *(run(name, margin) for name, margin in (("a", 0.5), ("b", -0.01), ("c", 0.02), ("d", -0.4))),
        *(run(name, margin, up) for name, margin in (("a", 0.5), ("b", 0.01), ("c", 0.03), ("d", -0.4))),
        *(run(name, margin, down) for name, margin in (("a", 0.5), ("b", 0.02), ("c", -0.01), ("d", -0.4))),
        run("a", -0.1, Change.HALF_STEP),
        run("b", -0.1, Change.HALF_STEP),
    ]
    numbers = flips_summary(rows)
    # b at more friction and c at less are the right way, b at less is not.
    assert (numbers["friction_flip"], numbers["n_friction"]) == (3 / 8, 8.0)
    assert (numbers["friction_right_way"], numbers["n_friction_flipped"]) == (pytest.approx(2 / 3), 3.0)
    assert (numbers["half_step_flip"], numbers["n_half_step"]) == (0.5, 2.0)
    assert numbers["finer_pad_flip"] is None
    assert (numbers["stored_differs"], numbers["n_stored"]) == (2.0, 4.0)
    assert [goes_right_way(run("x", margin, change)) for change in (up, down) for margin in (0.1, -0.1)] == [True, False, False, True]


def test_slips_go_the_right_way_where_they_differ() -> None:
    up, down = Change.FRICTION_UP, Change.FRICTION_DOWN
    rows = [{**run(name, 0.5), "slip_mm": 1.0} for name in "abcd"]
    rows += [{**run(name, 0.5, up), "slip_mm": slip_mm} for name, slip_mm in (("a", 0.5), ("b", 1.05), ("c", 2.0))]
    rows += [{**run(name, 0.5, down), "slip_mm": slip_mm} for name, slip_mm in (("a", 1.5), ("b", 3.0))]
    rows += [{**run("d", -9.0, up), "slip_mm": 60.0, "status": "dropped_in_transport"}]
    numbers = flips_summary(rows)
    # b at more friction slips the same, d has fallen; c slips more with more friction.
    assert (numbers["friction_slip_right_way"], numbers["n_friction_slip"]) == (3 / 4, 4.0)


def test_lifts_hold_under_every_change() -> None:
    rows = []
    for model in (can_model(), cuboid_model()):
        scene = scene_of(model)
        (grasp,) = admitted_grasps(admission_rows(model, scene, AdmissionParams(quota=1)))
        rows += [lifts_row(LiftCase(model, scene, grasp, RECIPE), "lifted", change) for change in CHANGES]
    # Both have the name of their scene and grasp, which in one tier is one.
    numbers = [lifts_summary(rows[k : k + len(CHANGES)]) for k in (0, len(CHANGES))]
    for own in numbers:
        assert (own["lift_half_step_flip"], own["lift_friction_flip"], own["lift_stored_differs"]) == (0.0, 0.0, 0.0)
        assert (own["n_lift_half_step"], own["n_lift_friction"], own["n_lift_stored"]) == (1.0, 2.0, 1.0)


def test_light_loads_stay_where_they_are() -> None:
    """Real transports of cans and cuboids, their outcomes from the engine, their loads from theory."""
    rows = []
    for name in ("can", "cuboid"):
        for case in cases(name, 3):
            label = flips_row(case, "success", Change.NONE)
            stored = {"exec_status": label["status"], "y_pipe": label["is_success"], "category": name}
            stored |= {"transport_slip_m": label["slip_mm"] / 1e3, "transport_slip_rad": 0.0}
            rows.append(loads_row(case, {"candidate_id": label["candidate_id"], **stored}))
    assert all(0.0 < row["demand"] < 1.0 and row["preload"] < 1.0 for row in rows)
    numbers = loads_summary(rows)
    for key in ("transport_slip_mm_max", "light_load_drops"):
        value = numbers[key]
        assert value is not None
        assert BOUNDS[key].holds(value), key
    assert numbers["n_transport_slip"] >= 2.0


def load(demand: float | None, status: str = "success", slip_mm: float = 0.0, category: str = "cuboid") -> Row:
    row = {"candidate_id": "x", "category": category, "exec_status": status, "y_pipe": status == "success", "preload": 0.1}
    row["is_lost"] = status == "dropped_in_transport" or slip_mm > 2.0
    return {**row, "transport_slip_m": slip_mm / 1e3, "demand": demand, "demand_even_pads": 0.2}


def test_loads_are_told_apart_by_their_share_of_the_capacity() -> None:
    rows = [load(0.1, slip_mm=0.3), load(0.25, slip_mm=0.6), load(0.26, slip_mm=5.0), load(0.4, "dropped_in_transport")]
    rows += [load(0.45, "slipped_in_hand", 2.5), load(0.6, "dropped_in_transport", 60.0), load(None, "dropped_in_transport", 70.0)]
    rows += [load(0.2, "off_target", 0.7, category="can")]
    numbers = loads_summary(rows)
    assert (numbers["transport_slip_mm_max"], numbers["n_transport_slip"]) == (pytest.approx(0.7), 3.0)
    assert (numbers["light_load_drops"], numbers["n_light_load"]) == (3.0, 6.0)
    # Good are the three smallest of seven cuboids.
    assert (numbers["cuboid_auc"], numbers["n_cuboid_auc"]) == (1.0, 7.0)
    assert numbers["transport_slip_even_pads_mm_max"] == pytest.approx(70.0)


def test_the_area_under_the_roc_is_the_chance_of_the_right_order() -> None:
    rng = np.random.Generator(np.random.PCG64(1))
    scores, is_good = rng.integers(0, 5, 60).astype(float), rng.random(60) < 0.4
    pairs = [(a > b) + 0.5 * (a == b) for a in scores[is_good] for b in scores[~is_good]]
    assert area_under_roc(scores, is_good) == pytest.approx(np.mean(pairs))
    assert area_under_roc(scores, np.ones(60, dtype=bool)) is None


def test_a_mixed_choice_has_equal_categories_and_natural_rates() -> None:
    sizes = {("can", "success"): 80, ("can", "dropped"): 20, ("mug", "success"): 500, ("mug", "off"): 499, ("mug", "slipped"): 1}
    sizes |= {("cuboid", "success"): 5, ("cuboid", "dropped"): 2}
    strata = {key: [f"{key[0]}-{key[1]}-{k}" for k in range(n)] for key, n in sizes.items()}
    chosen = choose_mixed(strata, 42, "test", 90)
    counted = Counter(tuple(name.rsplit("-", 1)[0].split("-")) for name in chosen)
    assert counted == {("can", "success"): 24, ("can", "dropped"): 6, ("cuboid", "success"): 5, ("cuboid", "dropped"): 2} | {
        ("mug", "success"): 15,
        ("mug", "off"): 15,
    }
    assert chosen == choose_mixed({key: ids[::-1] for key, ids in reversed(strata.items())}, 42, "test", 90)
    assert chosen != choose_mixed(strata, 43, "test", 90)
    assert chosen != choose_mixed(strata, 42, "other", 90)
    # An odd number is dealt out to the last place.
    assert len(choose_mixed({key: ids for key, ids in strata.items() if key[0] != "cuboid"}, 42, "test", 91)) == 91


@pytest.mark.parametrize("name", ["n_grasps", "n_executions"])
def test_nothing_to_measure_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} = 0, must be at least 1"):
        Sizes(**{name: 0})
