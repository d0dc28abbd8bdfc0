"""Synthetic releases shared by the ranker's tests, and the smallest settings that still have every part."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from model import local_settings
from model.local_settings import LocalSettings
from model.settings import LIGHT, RankerSettings, TrainingSettings, Variant
from model.training import train
from tests.model.commands import Commands
from tests.model.damage import copy_of
from tests.model.synthetic_release import write_synthetic_release

TINY = replace(
    LIGHT,
    name="tiny",
    n_points=64,
    n_centres_1=16,
    n_neighbours_1=8,
    n_centres_2=8,
    n_neighbours_2=4,
    widths_1=(8, 12),
    widths_2=(16, 24),
    width_global=32,
    n_epochs=4,
)

TINY_LOCAL = replace(
    local_settings.LIGHT,
    name="tiny",
    n_object_points=8,
    n_obstacle_points=16,
    n_environment_points=8,
    n_near_obstacle=6,
    n_near_environment=3,
    point_widths=(8, 12),
    widths=(24, 16),
    head_width=8,
    n_bins=4,
    n_members=3,
    n_epochs=4,
)


@pytest.fixture(scope="session")
def tiny() -> RankerSettings:
    return TINY


@pytest.fixture(scope="session")
def tiny_local() -> LocalSettings:
    return TINY_LOCAL


def tiny_of(variant: Variant) -> TrainingSettings:
    return TINY_LOCAL if variant.is_local else TINY


@pytest.fixture(scope="session")
def small_release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five scenes: three to train on, one validation, one test."""
    return write_synthetic_release(tmp_path_factory.mktemp("small"), n_scenes=5, seed=3, n_points=160)


@pytest.fixture(scope="session")
def checkpoint(small_release: Path, tiny: RankerSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A full ranker of seed 7, trained on `small_release`; damage copies of it."""
    return train(small_release, "full", 7, tiny, tmp_path_factory.mktemp("checkpoint")).checkpoint_dir


@pytest.fixture
def release(small_release: Path, tmp_path: Path) -> Path:
    """A copy of `small_release` to damage."""
    return copy_of(small_release, tmp_path / "release")


@pytest.fixture
def copy(checkpoint: Path, tmp_path: Path) -> Path:
    """A copy of `checkpoint` to damage."""
    return copy_of(checkpoint, tmp_path / "checkpoint")


@pytest.fixture
def commands(release: Path, checkpoint: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Commands:
    return Commands(release, checkpoint, tmp_path, capfd)
