"""Datasets of two catalogues never share a folder; a catalogue may only grow."""

from __future__ import annotations

from pathlib import Path

import pytest

from objects.catalogue import PACKAGED_CATALOGUE
from pipelines.running.data_root import DataRoot
from pipelines.running.dataset_record import DatasetError, check_dataset, claim_dataset
from tests.objects.test_catalogue import BOX, CAN, MUG, write


def file(folder: Path, name: str, *entries: dict[str, str], head: str = "") -> Path:
    path = write(folder, *entries)
    path.write_text(head + path.read_text())
    return path.rename(folder / name)


@pytest.fixture
def root(tmp_path: Path) -> DataRoot:
    """Of a catalogue with a box and a can."""
    root = DataRoot(tmp_path / "data")
    claim_dataset(root, file(tmp_path, "two.toml", BOX, CAN))
    return root


def test_a_catalogue_may_grow_behind_its_objects_and_change_its_values(root: DataRoot, tmp_path: Path) -> None:
    grown = file(tmp_path, "grown.toml", {**BOX, "mass_kg": "0.2"}, CAN, MUG)
    claim_dataset(root, grown)
    check_dataset(root, grown)
    with pytest.raises(DatasetError, match="append new objects behind those"):
        check_dataset(root, file(tmp_path, "two.toml", BOX, CAN))


@pytest.mark.parametrize("entries", [(CAN, BOX), (BOX,), (MUG, BOX, CAN)], ids=["other order", "one less", "one before"])
def test_other_objects_in_front_are_refused_in_one_line(entries: tuple[dict[str, str], ...], root: DataRoot, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"holds a dataset of catalogue two\.toml \(appended: box, tin\), other\.toml is") as refused:
        check_dataset(root, file(tmp_path, "other.toml", *entries))
    assert "\n" not in str(refused.value)


def test_another_allocation_is_refused(root: DataRoot, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"turns\.toml is interleaved: box, tin; keep its objects"):
        check_dataset(root, file(tmp_path, "turns.toml", BOX, CAN, head='allocation = "interleaved"\n'))


def test_the_benchmark_keeps_its_folder_and_leaves_others_alone(root: DataRoot, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"holds a dataset of catalogue two\.toml, not of the benchmark's"):
        check_dataset(root, PACKAGED_CATALOGUE)
    benchmark = DataRoot(tmp_path / "benchmark")
    claim_dataset(benchmark, PACKAGED_CATALOGUE)
    assert not benchmark.path.exists(), "the benchmark has no record"
    (benchmark.path / "release").mkdir(parents=True)
    check_dataset(benchmark, PACKAGED_CATALOGUE)
    with pytest.raises(DatasetError, match=r"holds a dataset of the benchmark's catalogue; one of grown\.toml needs another folder"):
        claim_dataset(benchmark, file(tmp_path, "grown.toml", BOX))


@pytest.mark.parametrize("text", ["{", "[]", '{"catalogue": "a.toml"}'])
def test_a_damaged_record_is_told(text: str, root: DataRoot, tmp_path: Path) -> None:
    root.dataset_record().write_text(text)
    with pytest.raises(DatasetError, match=r"dataset\.json: cannot be read"):
        check_dataset(root, file(tmp_path, "two_again.toml", BOX, CAN))
