"""The command line: cards, pictures, errors on the error stream, exit codes; and what scene sampling would make of an object."""

from __future__ import annotations

import shutil
from pathlib import Path

import pybullet_data
import pytest
import trimesh
from PIL import Image

from objects.build import ObjectParams, build_object, build_object_models
from objects.card import card_rows
from objects.catalogue import CuboidShape, load_catalogue
from objects.grasp_pool import GraspPoolParams
from pipelines.engines.physics.params import PhysicsParams
from pipelines.inspect import main
from pipelines.recipe import load_recipe
from pipelines.scenes.draws import SceneSamplingParams
from pipelines.scenes.outlook import N_SPOTS, scene_outlook
from tests.objects.shapes import spec_of
from tests.objects.test_catalogue import BOX, write

WIDE = {**BOX, "id": '"crate"', "size_m": "[0.1, 0.1, 0.1]"}
OWN = {"id": '"own"', "category": '"mesh"', "name": '"n"', "source": '"s"', "mass_kg": "0.1", "mesh": '"gone.stl"'}
# Fewer candidates: the mechanics are the same and a build takes a fifth of the time.
QUICK = "seed = 3\n[objects.grasp_pool]\nn_candidates = 4000\n"


@pytest.fixture
def recipe(tmp_path: Path) -> list[str]:
    (tmp_path / "recipe.toml").write_text(QUICK)
    return ["--recipe", str(tmp_path / "recipe.toml")]


def words(shown: str) -> str:
    """What a card says, without its frame and line breaks."""
    return " ".join(shown.replace("│", " ").split())


def test_good_objects_are_shown_and_bad_ones_named_with_exit_code_1(
    tmp_path: Path, recipe: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    named = {**BOX, "name": '"a [bold]box[/red]"', "source": '"[/]"'}
    code = main([str(write(tmp_path, WIDE, OWN, named)), "--png", str(tmp_path / "pictures"), *recipe])
    shown = capsys.readouterr()
    assert code == 1
    assert "crate: smallest graspable width 0.1000 m, must be at most 0.0750" in shown.err
    assert "own: mesh file" in shown.err
    assert "2 of 3 objects failed" in shown.err
    for word in ("box: a [bold]box[/red]", "50.0 x 60.0 x 70.0 mm", "300 g", "1 convex", "face_x", "64: face_x", "source [/]"):
        assert word in words(shown.out)
    assert "crate" not in shown.out
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["box.png"]
    with Image.open(tmp_path / "pictures" / "box.png") as picture:
        colours = picture.convert("RGB").getcolors(maxcolors=1_000_000)
    assert colours is not None
    assert len(colours) > 50, "the picture is blank"


def test_objects_are_those_of_the_recipe(tmp_path: Path, recipe: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """The card counts the grasps that a build with the seed and the parameters of the recipe file has."""
    mug = {
        **BOX, "id": '"cup"', "category": '"mug"', "diameter_m": "0.082", "height_m": "0.095", "wall_m": "0.0045", "base_m": "0.007",
        "handle_reach_m": "0.036", "handle_height_m": "0.07", "handle_thickness_m": "0.01", "handle_width_m": "0.014",
    }  # fmt: skip
    del mug["size_m"]
    catalogue = write(tmp_path, mug)
    assert main([str(catalogue), *recipe]) == 0
    made = load_recipe("full", tmp_path / "recipe.toml")
    built = build_object(load_catalogue(catalogue)[0], made.objects, made.seed)
    shown = words(capsys.readouterr().out)
    for label, text in card_rows(built):
        assert f"{label} {text}" in shown
    assert dict(card_rows(built)) != dict(card_rows(build_object(load_catalogue(catalogue)[0], made.objects, made.seed + 1)))


def test_a_repaired_mesh_says_so_on_its_card_and_a_file_outside_needs_leave(
    tmp_path: Path, recipe: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    trimesh.Trimesh(ball.vertices, ball.faces[1:]).export(tmp_path / "own.stl")
    folder = tmp_path / "mine"
    folder.mkdir()
    catalogue = write(folder, {**OWN, "mesh": '"../own.stl"'})
    assert main([str(catalogue), *recipe]) == 1
    assert "own: mesh '../own.stl' lies outside" in capsys.readouterr().err
    main([str(catalogue), "--allow-outside", *recipe])
    shown = words(capsys.readouterr().out)
    assert "repaired closed holes along 3 open edges" in shown
    assert "source s; its mesh was repaired; closed holes along 3 open edges" in shown


@pytest.mark.parametrize(
    ("mesh", "scale", "code", "said"),
    [
        # Of 64 grasps on a cube, those from its four sides are free wherever it stands: a third.
        (
            "cube.obj",
            0.05,
            1,
            "error: own: 22 grasps within reach at the best of 16 spots of any resting pose that stays, must be at least 26",
        ),
        ("racecar/meshes/cone.obj", 0.7, 0, "2 convex, hull volume 1.002 x mesh volume"),
        ("domino/domino.obj", 1.0, 1, "error: own: extent along y 0.00635 m, must be in [0.01, 0.4] m"),
    ],
)
def test_meshes_that_come_with_a_simulator_are_shown_or_refused(
    tmp_path: Path, recipe: list[str], mesh: str, scale: float, code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(Path(pybullet_data.getDataPath()) / mesh, tmp_path / "own.obj")
    assert main([str(write(tmp_path, {**OWN, "mesh": '"own.obj"', "scale": str(scale)})), *recipe]) == code
    shown = capsys.readouterr()
    assert said in words(shown.err if code else shown.out)


def test_one_object_can_be_picked(tmp_path: Path, recipe: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(write(tmp_path, WIDE, BOX)), "--object", "box", *recipe]) == 0
    assert "crate" not in capsys.readouterr().err


def test_an_unknown_object_and_bad_files_end_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(write(tmp_path, BOX)), "--object", "vase"]) == 1
    assert main([str(tmp_path / "missing.toml")]) == 1
    assert main([str(write(tmp_path, BOX)), "--recipe", str(tmp_path / "none.toml")]) == 1
    shown = capsys.readouterr().err
    assert "vase: not in the catalogue" in shown
    assert "missing.toml: cannot be read" in shown
    assert "none.toml" in shown


def test_an_object_without_scenes_is_shown_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A recipe whose workspace is out of reach: nothing is wrong with the object, and no scene could be drawn."""
    (tmp_path / "far.toml").write_text(QUICK + "[scene_sampling]\nradius_m = [0.87, 0.88]\n")
    assert main([str(write(tmp_path, BOX)), "--recipe", str(tmp_path / "far.toml")]) == 1
    shown = capsys.readouterr()
    assert "scenes start from no pose" in words(shown.out)
    assert f"at the best of {N_SPOTS} spots of any resting pose that stays, must be at least 26" in shown.err


def test_the_outlook_of_a_box_counts_what_sampling_asks_for() -> None:
    params = ObjectParams(grasp_pool=GraspPoolParams(n_candidates=4000))
    model = build_object_models([spec_of(CuboidShape((0.05, 0.06, 0.07)), "box")], params, 3)["box"]
    sampling = SceneSamplingParams()
    outlooks = scene_outlook(model, sampling, PhysicsParams(), 3)
    assert [outlook.resting for outlook in outlooks] == [rest.resting for rest in model.stable_poses]
    for outlook in outlooks:
        assert outlook.stays
        assert len(outlook.within_reach) == N_SPOTS
        assert max(outlook.within_reach) <= sum(outlook.above_table.values()) <= len(model.grasps)
        assert outlook.start_spots == sum(n >= sampling.min_initial_grasps for n in outlook.within_reach)
        assert outlook.target_spots >= outlook.start_spots
    assert scene_outlook(model, sampling, PhysicsParams(), 3) == outlooks
