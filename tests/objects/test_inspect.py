"""The command line: cards, pictures, errors on the error stream, exit codes."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from objects.inspect import main
from tests.objects.test_catalogue import BOX, write

WIDE = {**BOX, "id": '"crate"', "size_m": "[0.1, 0.1, 0.1]"}
OWN = {"id": '"own"', "category": '"mesh"', "name": '"n"', "source": '"s"', "mass_kg": "0.1", "mesh": '"gone.stl"'}


def test_good_objects_are_shown_and_bad_ones_named_with_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main([str(write(tmp_path, WIDE, OWN, BOX)), "--png", str(tmp_path / "pictures")])
    shown = capsys.readouterr()
    assert code == 1
    assert "crate: smallest graspable width 0.1000 m, must be at most 0.0750" in shown.err
    assert "own: mesh file" in shown.err
    assert "2 of 3 objects failed" in shown.err
    for word in ("box: a box", "50.0 x 60.0 x 70.0 mm", "300 g", "1 convex", "face_x", "64: face_x", "a shop"):
        assert word in shown.out
    assert "crate" not in shown.out
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["box.png"]
    with Image.open(tmp_path / "pictures" / "box.png") as picture:
        colours = picture.convert("RGB").getcolors(maxcolors=1_000_000)
    assert colours is not None
    assert len(colours) > 50, "the picture is blank"


def test_one_object_can_be_picked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(write(tmp_path, WIDE, BOX)), "--object", "box"]) == 0
    assert "crate" not in capsys.readouterr().err


def test_an_unknown_object_and_a_bad_file_end_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(write(tmp_path, BOX)), "--object", "vase"]) == 1
    assert main([str(tmp_path / "missing.toml")]) == 1
    shown = capsys.readouterr().err
    assert "vase: not in the catalogue" in shown
    assert "missing.toml: cannot be read" in shown
