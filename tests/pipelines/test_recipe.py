"""The shipped recipe is what the classes default to; a bad one is refused in one line; its hash is what decides."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from pipelines.proofs.regenerate import main as regenerate_main
from pipelines.recipe import DEFAULT_RECIPE, FAMILIES, Recipe, RecipeError, load_recipe


def _write(folder: Path, content: str) -> Path:
    path = folder / "recipe.toml"
    path.write_text(content)
    return path


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values by their whole key, tuples as lists."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = list(value) if isinstance(value, tuple) else value
    return flat


def _shipped() -> dict[str, Any]:
    return tomllib.loads(DEFAULT_RECIPE.read_text(encoding="utf-8"))


def test_the_defaults_of_the_classes_are_the_recipe_of_full() -> None:
    """Every test that says `MotionParams()` runs the shipped motion, and so on."""
    assert load_recipe("full") == Recipe()
    defaults = _flat(dataclasses.asdict(Recipe()))
    shipped = {key: value for key, value in _flat(_shipped()).items() if not key.startswith(FAMILIES)}
    assert len(shipped) > 20
    assert {key: defaults[key] for key in shipped} == shipped


@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_differs_by_what_the_file_overrides_and_nothing_else(family: str) -> None:
    base, own = (_flat(dataclasses.asdict(recipe)) for recipe in (Recipe(), load_recipe(family)))
    overrides = _flat(_shipped().get(family, {}))
    assert {key: own[key] for key in own if own[key] != base[key]} == overrides
    assert bool(overrides) == (load_recipe(family).hash_of() != Recipe().hash_of())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        # Keys.
        ("[grasp_admissions]\nquota = 3\n", "recipe.grasp_admissions: unknown key, must be one of ['camera', 'execution', "),
        ("[grasp_admission]\nquotas = 3\n", "recipe.grasp_admission.quotas: unknown key, must be one of ['finger_clearance_m', "),
        ("[mini.grasp_admission]\nquotas = 3\n", "recipe.mini.grasp_admission.quotas: unknown key, must be one of "),
        ("[full]\nseeds = 3\n", "recipe.full.seeds: unknown key, must be one of "),
        ("[objects.pool]\nfriction = 0.3\n", "recipe.objects.pool: unknown key, must be one of ['decomposition', "),
        # Types.
        ("[grasp_admission]\nquota = 2.5\n", "recipe.grasp_admission.quota: 2.5 is float, must be int"),
        ("[grasp_admission]\nquota = true\n", "recipe.grasp_admission.quota: True is bool, must be int"),
        ("[motion]\nvelocity_scale = true\n", "recipe.motion.velocity_scale: True is bool, must be float"),
        ('[motion]\nvelocity_scale = "fast"\n', "recipe.motion.velocity_scale: 'fast' is str, must be float"),
        (f"[motion]\nline_speed_m_s = 1{400 * '0'}\n", "is int, must be float"),
        ("seed = 4.2\n", "recipe.seed: 4.2 is float, must be int"),
        ("grasp_admission = 3\n", "recipe.grasp_admission: 3, must be a table"),
        ("mini = 3\n", "recipe.mini: 3, must be a table"),
        ("[objects.grasp_pool]\nshares = 3\n", "recipe.objects.grasp_pool.shares: 3, must be a table"),
        ("[objects.grasp_pool.shares]\nrim = 'all'\n", "recipe.objects.grasp_pool.shares.rim: 'all' is str, must be float"),
        ("[scene_sampling]\nradius_m = [0.3]\n", "recipe.scene_sampling.radius_m: [0.3], must be a list of 2"),
        ("[scene_sampling]\nradius_m = 0.3\n", "recipe.scene_sampling.radius_m: 0.3, must be a list of 2"),
        ("[objects.grasp_pool]\ndepths_m = 0.3\n", "recipe.objects.grasp_pool.depths_m: 0.3, must be a list"),
        ("[camera]\neyes_m = [[1.0, 'a', 0.8]]\n", "recipe.camera.eyes_m[0][1]: 'a' is str, must be float"),
        # Numbers that are none.
        ("[motion]\nvelocity_scale = nan\n", "recipe.motion.velocity_scale: nan, must be finite"),
        ("[execution]\nhold_s = inf\n", "recipe.execution.hold_s: inf, must be finite"),
        ("[scene_sampling]\nradius_m = [0.3, -inf]\n", "recipe.scene_sampling.radius_m[1]: -inf, must be finite"),
        ("[objects.grasp_pool.shares]\nrim = nan\n", "recipe.objects.grasp_pool.shares.rim: nan, must be finite"),
        # Bounds.
        ("[grasp_admission]\nquota = 300\n", "recipe.grasp_admission.quota = 300, must be in [1, 64]"),
        ("[mini.grasp_admission]\nquota = 0\n", "recipe.mini.grasp_admission.quota = 0, must be in [1, 64]"),
        ("[motion]\nvelocity_scale = 1.5\n", "recipe.motion.velocity_scale = 1.5, must be in [0.01, 1]"),
        ("[planning]\nrelease_height_m = 0.001\n", "recipe.planning.release_height_m = 0.001, must be in [0.002, 0.05]"),
        ("[planning.search]\nmax_checks = 0\n", "recipe.planning.search.max_checks = 0, must be in [1, 1e+07]"),
        ("[scene_sampling]\nradius_m = [0.5, 0.4]\n", "recipe.scene_sampling.radius_m = (0.5, 0.4), must be increasing"),
        ("[objects.grasp_pool]\nfriction = 9.0\n", "recipe.objects.grasp_pool: GraspPoolParams.friction = 9.0, must be in [0.05, 2.0]"),
        ("[pick_lift]\nmin_rise_m = 0.2\n", "recipe.pick_lift.min_rise_m = 0.2, must be below lift_m = 0.12"),
        ("[execution]\ndragged_m = 0.008\n", "recipe.execution.dragged_m = 0.008, must be at most position_tolerance_m = 0.0075"),
        # What all families share.
        ("[mini]\nseed = 7\n", "recipe.mini.seed: 7, must not be there: objects are shared by all families"),
    ],
)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_bad_recipe_is_one_line_with_key_value_and_bound(tmp_path: Path, content: str, message: str, family: str) -> None:
    """Whichever family is loaded, and whichever the mistake is in."""
    with pytest.raises(RecipeError) as caught:
        load_recipe(family, _write(tmp_path, content))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[pick_lift]\nlift_m = 0.13\n", "pick_lift.lift_m = 0.13, must be equal to grasp_admission.lift_m = 0.12"),
        ("[grasp_admission]\nlift_m = 0.1\n", "pick_lift.lift_m = 0.12, must be equal to grasp_admission.lift_m = 0.1"),
        (
            "[scene_sampling]\nobstacle_size_m = [0.1, 0.1, 0.2]\n",
            "pick_lift.lift_m = 0.12, must be at least scene_sampling.obstacle_size_m[2] = 0.2",
        ),
        (
            "[objects.grasp_pool]\npalm_clearance_m = 0.001\n",
            "objects.grasp_pool.palm_clearance_m = 0.001, must be at least grasp_admission.palm_clearance_m = 0.002",
        ),
        (
            "[grasp_admission]\ntable_clearance_m = 0.01\n",
            "objects.grasp_pool.table_clearance_m = 0.003, must be at least grasp_admission.table_clearance_m = 0.01",
        ),
        (
            "[grasp_admission]\npregrasp_m = 0.2\n",
            "objects.grasp_pool.approach_m = 0.1, must be at least grasp_admission.pregrasp_m = 0.2",
        ),
        (
            "[scene_sampling]\nmin_initial_grasps = 33\n",
            "objects.grasp_pool.min_grasps = 32, must be at least scene_sampling.min_initial_grasps = 33",
        ),
        (
            "[scene_sampling]\nmin_target_grasps = 65\n",
            "objects.grasp_pool.n_grasps = 64, must be at least scene_sampling.min_target_grasps = 65",
        ),
        (
            "[scene_sampling]\ntarget_gap_m = 0.005\n",
            "scene_sampling.target_gap_m = 0.005, must be at least execution.position_tolerance_m = 0.0075",
        ),
        (
            "[scene_sampling]\nmax_drift_m = 0.01\n",
            "scene_sampling.max_drift_m = 0.01, must be at most execution.position_tolerance_m = 0.0075",
        ),
        (
            "[scene_sampling]\nmax_drift_rad = 0.1\n",
            "scene_sampling.max_drift_rad = 0.1, must be at most execution.rotation_tolerance_rad = 0.08726646259971647",
        ),
        ("[camera]\nmax_radius_m = 0.75\n", "scene_sampling.radius_m[1] = 0.78, must be at most camera.max_radius_m = 0.75"),
        ("[physics]\ntable_x_m = [-0.4, 0.7]\n", "scene_sampling.radius_m[1] = 0.78, must be at most physics.table_x_m[1] = 0.7"),
        ("[physics]\ntable_y_m = [-0.9, 0.7]\n", "scene_sampling.radius_m[1] = 0.78, must be at most physics.table_y_m[1] = 0.7"),
        ("[hand_physics]\ntable_x_m = [-0.4, 0.7]\n", "scene_sampling.radius_m[1] = 0.78, must be at most hand_physics.table_x_m[1] = 0.7"),
        (
            "[scene_sampling]\nobstacle_radius_m = [0.3, 0.96]\n",
            "scene_sampling.obstacle_radius_m[1] = 0.96, must be at most camera.max_radius_m = 0.95",
        ),
        (
            "[pick_lift]\nmax_close_s = 0.7\n",
            "pick_lift.max_close_s = 0.7, must be at least 0.8: 0.04 m at hand_physics.finger_speed_m_s = 0.05",
        ),
        (
            "[execution]\nmax_open_s = 0.2\n",
            "execution.max_open_s = 0.2, must be at least 0.24: 0.012 m at hand_physics.finger_speed_m_s = 0.05",
        ),
        (
            "[planning]\nrelease_height_m = 0.05\n[execution]\nrelease_wait_s = 0.05\n",
            "execution.release_wait_s = 0.05, must be at least 0.101: a fall from planning.release_height_m = 0.05",
        ),
        (
            "[execution]\nmax_settle_steps = 20\n",
            "execution.max_settle_steps = 20, must be at least 24: hand_physics.settled_checks = 3 times"
            " hand_physics.check_every_steps = 8",
        ),
    ],
)
def test_sections_that_disagree_are_refused_with_both_keys_and_values(tmp_path: Path, content: str, message: str) -> None:
    with pytest.raises(RecipeError) as caught:
        load_recipe("full", _write(tmp_path, content))
    assert str(caught.value) == f"recipe: {message}"


def test_an_override_that_disagrees_is_refused_for_its_family(tmp_path: Path) -> None:
    path = _write(tmp_path, "[mini.pick_lift]\nlift_m = 0.13\n")
    with pytest.raises(RecipeError, match=r"^recipe\.mini: pick_lift\.lift_m = 0\.13, must be equal to grasp_admission\.lift_m = 0\.12$"):
        load_recipe("full", path)
    both = _write(tmp_path, "[mini.pick_lift]\nlift_m = 0.13\n[mini.grasp_admission]\nlift_m = 0.13\n")
    assert (load_recipe("mini", both).pick_lift.lift_m, load_recipe("full", both).pick_lift.lift_m) == (0.13, 0.12)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[motion\nvelocity_scale = 1\n", r"recipe .*recipe\.toml: Expected .*line 1.*, must be TOML"),
        (b"seed = 1\nseed = 2\n", r"recipe .*recipe\.toml: Cannot overwrite a value.*line 2.*, must be TOML"),
        (b"# caf\xe9\nseed = 1\n", r"recipe .*recipe\.toml: byte 0xe9 at 5, must be UTF-8"),
    ],
)
def test_a_file_that_is_no_toml_is_refused_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "recipe.toml"
    path.write_bytes(content)
    with pytest.raises(RecipeError, match=f"^{message}$") as caught:
        load_recipe("full", path)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match=r"^recipe .*none\.toml: No such file or directory, must be a readable file$"):
        load_recipe("full", tmp_path / "none.toml")
    with pytest.raises(RecipeError, match=r"^recipe .*: Is a directory, must be a readable file$"):
        load_recipe("full", tmp_path)


def test_the_command_line_prints_a_bad_recipe_as_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = _write(tmp_path, "[motion]\nvelocity_scale = 1.5\n")
    assert regenerate_main(["full-0000", "--data", str(tmp_path), "--recipe", str(path)]) == 1
    assert capsys.readouterr().err == "recipe.motion.velocity_scale = 1.5, must be in [0.01, 1]\n"


def test_a_whole_number_is_a_real_number(tmp_path: Path) -> None:
    assert load_recipe("full", _write(tmp_path, "[motion]\nvelocity_scale = 1\n")).motion.velocity_scale == 1.0


@pytest.mark.parametrize("loaded", FAMILIES)
@pytest.mark.parametrize("family", FAMILIES)
def test_objects_of_one_family_only_are_refused_whichever_family_is_loaded(tmp_path: Path, family: str, loaded: str) -> None:
    path = _write(tmp_path, f"[{family}.objects.grasp_pool]\nn_grasps = 32\n")
    with pytest.raises(RecipeError, match=rf"recipe\.{family}\.objects: .*'n_grasps': 32.*objects are shared by all families"):
        load_recipe(loaded, path)


def test_objects_of_all_families_are_read_for_each(tmp_path: Path) -> None:
    path = _write(tmp_path, "[objects.grasp_pool]\nn_grasps = 32\n[mini.grasp_admission]\nquota = 3\n")
    assert load_recipe("mini", path).objects == load_recipe("full", path).objects
    assert load_recipe("mini", path).objects.grasp_pool.n_grasps == 32


def test_an_unknown_family_is_refused() -> None:
    with pytest.raises(RecipeError, match=r"^family 'pilot', must be one of \['mini', 'full'\]$"):
        load_recipe("pilot")


def test_a_type_that_is_no_section_is_refused() -> None:
    with pytest.raises(RecipeError, match=r"int: no section of the recipe, must be one of \['AdmissionParams', "):
        Recipe().sections(int)


def test_the_hash_follows_seed_and_section(tmp_path: Path) -> None:
    base = load_recipe("full", _write(tmp_path, ""))
    slow = load_recipe("full", _write(tmp_path, "[motion]\nvelocity_scale = 0.4\n"))
    reseeded = load_recipe("full", _write(tmp_path, "seed = 7\n"))
    assert base.hash_of("camera") == slow.hash_of("camera") != reseeded.hash_of("camera")
    assert base.hash_of("motion") != slow.hash_of("motion")
