"""A recipe is rejected by name, value and bound; what it hashes is what decides."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.recipe import Recipe, RecipeError, load_recipe


def _write(folder: Path, content: str) -> Path:
    path = folder / "recipe.toml"
    path.write_text(content)
    return path


def test_the_packaged_recipe_loads_and_mini_differs_by_its_quota_only() -> None:
    mini, full = load_recipe("mini"), load_recipe("full")
    assert (mini.grasp_admission.quota, full.grasp_admission.quota) == (16, 32)
    sections = [name for name in Recipe.__dataclass_fields__ if name not in ("seed", "grasp_admission")]
    assert mini.hash_of(*sections) == full.hash_of(*sections)
    assert mini.hash_of() != full.hash_of()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[grasp_admissions]\nquota = 3\n", "recipe.grasp_admissions: unknown key"),
        ("[grasp_admission]\nquotas = 3\n", "recipe.grasp_admission.quotas: unknown key"),
        ("[grasp_admission]\nquota = 300\n", r"quota = 300, must be in \[1, 64\]"),
        ("[grasp_admission]\nquota = 2.5\n", "recipe.grasp_admission.quota: 2.5 is float, must be int"),
        ("[grasp_admission]\nquota = true\n", "recipe.grasp_admission.quota: True is bool, must be int"),
        ("grasp_admission = 3\n", "recipe.grasp_admission: 3, must be a table"),
        ("[scene_sampling]\nradius_m = [0.3]\n", "must be a list of 2"),
        ("[motion]\nvelocity_scale = 1.5\n", "velocity_scale = 1.5"),
    ],
)
def test_a_bad_recipe_names_key_value_and_bound(tmp_path: Path, content: str, message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        load_recipe("full", _write(tmp_path, content))


def test_a_whole_number_is_a_real_number(tmp_path: Path) -> None:
    assert load_recipe("full", _write(tmp_path, "[motion]\nvelocity_scale = 1\n")).motion.velocity_scale == 1.0


@pytest.mark.parametrize("loaded", ["mini", "full"])
@pytest.mark.parametrize("family", ["mini", "full"])
def test_objects_of_one_family_only_are_refused_whichever_family_is_loaded(tmp_path: Path, family: str, loaded: str) -> None:
    path = _write(tmp_path, f"[{family}.objects.grasp_pool]\nn_grasps = 32\n")
    with pytest.raises(RecipeError, match=rf"recipe\.{family}\.objects: .*'n_grasps': 32.*objects are shared by all families"):
        load_recipe(loaded, path)


def test_objects_of_all_families_are_read_for_each(tmp_path: Path) -> None:
    path = _write(tmp_path, "[objects.grasp_pool]\nn_grasps = 32\n[mini.grasp_admission]\nquota = 3\n")
    assert load_recipe("mini", path).objects == load_recipe("full", path).objects
    assert load_recipe("mini", path).objects.grasp_pool.n_grasps == 32


def test_an_unknown_family_is_refused() -> None:
    with pytest.raises(RecipeError, match="family 'pilot'"):
        load_recipe("pilot")


def test_the_hash_follows_seed_and_section(tmp_path: Path) -> None:
    base = load_recipe("full", _write(tmp_path, ""))
    slow = load_recipe("full", _write(tmp_path, "[motion]\nvelocity_scale = 0.4\n"))
    reseeded = load_recipe("full", _write(tmp_path, "seed = 7\n"))
    assert base.hash_of("camera") == slow.hash_of("camera") != reseeded.hash_of("camera")
    assert base.hash_of("motion") != slow.hash_of("motion")
