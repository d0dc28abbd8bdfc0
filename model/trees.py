"""The probe beside the networks: gradient-boosted trees on the derived geometry of candidates; how they rank is judged in reports.

Two heads as the networks have: P(plan) of all candidates, P(exec | plan) of the planned ones; the score is the sum of their logarithms.
Nothing is selected: the settings are fixed and no validation scene is read. The only module of the ranker that needs scikit-learn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float
from sklearn.ensemble import HistGradientBoostingClassifier
from threadpoolctl import threadpool_limits

from model.errors import SettingsError, TrainingError
from model.features import FEATURES, RAW_POSE_FEATURES, Feature
from model.geometry import candidate_geometry
from model.inputs import InputReader, ReleaseInputs, read_inputs, scenes_of_split
from model.labels import Labels, read_labels
from model.predictions import prediction_table
from model.release_tables import published_sha256
from model.settings import check_seed
from tables.identity import order_key
from tables.vocabulary import Split, SplitScheme


class TreeVariant(StrEnum):
    """What the trees see."""

    GEOMETRY = "trees"  # raw poses and everything derived from the five inputs
    POSES = "trees_poses"  # raw poses alone: what a table of the release holds

    @property
    def features(self) -> tuple[Feature, ...]:
        return FEATURES if self is TreeVariant.GEOMETRY else RAW_POSE_FEATURES


@dataclass(frozen=True, slots=True)
class TreeSettings:
    """Settings of both heads, as scikit-learn names them. Small trees, a third of the features a split: candidates of a scene are alike."""

    max_iter: int = 300
    learning_rate: float = 0.05
    max_leaf_nodes: int = 15
    min_samples_leaf: int = 30
    l2_regularization: float = 1.0
    max_features: float = 0.3

    def __post_init__(self) -> None:
        for name, low in (("max_iter", 1), ("max_leaf_nodes", 2), ("min_samples_leaf", 1)):
            if getattr(self, name) < low:
                raise SettingsError(f"{name}: {getattr(self, name)}, must be at least {low}")
        for name in ("learning_rate", "max_features"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise SettingsError(f"{name}: {getattr(self, name)}, must be in (0, 1]")
        if not 0.0 <= self.l2_regularization < float("inf"):
            raise SettingsError(f"l2_regularization: {self.l2_regularization}, must be finite and at least 0")


@dataclass(frozen=True, slots=True)
class TreeData:
    """Candidates of a release with their geometry, computed once, and their labels."""

    inputs: ReleaseInputs
    geometry: Float[np.ndarray, "c f"]
    labels: Labels

    @property
    def scene_ids(self) -> tuple[str, ...]:
        return tuple(cloud.scene_id for cloud in self.inputs.clouds)

    def of_scenes(self, scene_ids: Sequence[str]) -> Bool[np.ndarray, "c"]:
        """Which candidates belong to some scenes."""
        is_wanted = np.isin(np.array(self.scene_ids), np.array(scene_ids))
        mask: Bool[np.ndarray, "c"] = is_wanted[self.inputs.group_scene[self.inputs.candidate_group]]
        return mask


@dataclass(frozen=True, slots=True)
class ConstantHead:
    """A head whose candidates were all of one kind, as in a small dataset of easy objects: nothing separates them, so all are alike."""

    log_odds: float

    def decision_function(self, geometry: Float[np.ndarray, "c f"]) -> Float[np.ndarray, "c"]:
        return np.full(len(geometry), self.log_odds)


@dataclass(frozen=True, slots=True)
class Trees:
    """Two trained heads."""

    variant: TreeVariant
    plan: HistGradientBoostingClassifier | ConstantHead
    execution: HistGradientBoostingClassifier | ConstantHead

    def log_probabilities(self, geometry: Float[np.ndarray, "c f"]) -> Float[np.ndarray, "2 c"]:
        """Log P(plan) and log P(exec | plan), finite where a probability underflows."""
        seen = geometry[:, _columns_of(self.variant)]
        with threadpool_limits(1):
            log_p: Float[np.ndarray, "2 c"] = np.stack(
                [-np.logaddexp(0.0, -head.decision_function(seen)) for head in (self.plan, self.execution)]
            )
        return log_p


def read_tree_data(release_dir: Path) -> TreeData:
    """All candidates of a release; raises InputError where a table is missing, changed or holds an impossible value."""
    reader = InputReader(release_dir)
    inputs = read_inputs(reader)
    published_sha256(release_dir, reader.selected)
    return TreeData(inputs, candidate_geometry(inputs), read_labels(release_dir, inputs.candidate_ids))


def fit_trees(
    geometry: Float[np.ndarray, "c f"], labels: Labels, variant: TreeVariant, seed: int, settings: TreeSettings | None = None
) -> Trees:
    """Both heads on the candidates given; the same arguments give the same trees on every number of cores.

    Raises:
        SettingsError: a seed outside 32 bits.
    """
    check_seed(seed)
    heads: list[HistGradientBoostingClassifier | ConstantHead] = []
    for rows, truth in ((np.ones(len(geometry), dtype=bool), labels.y_plan), (labels.y_plan, labels.y_pipe)):
        n_true, n = int(truth[rows].sum()), int(rows.sum())
        if n_true in (0, n):
            # Laplace's rule of succession: never certain, less so the fewer were seen.
            heads.append(ConstantHead(math.log((n_true + 1) / (n - n_true + 1))))
            continue
        options = asdict(settings or TreeSettings())
        # Sums of several threads come in any order; seeds of scikit-learn are not negative.
        model = HistGradientBoostingClassifier(random_state=seed % 2**32, early_stopping=False, **options)
        with threadpool_limits(1):
            heads.append(model.fit(geometry[rows][:, _columns_of(variant)], truth[rows]))
    return Trees(variant, heads[0], heads[1])


def split_trees(release_dir: Path, data: TreeData, variant: TreeVariant, seed: int, scheme: SplitScheme = SplitScheme.SCENE) -> Trees:
    """Trees that saw the train split of a scheme alone; raises as `fit_trees`, and TrainingError where that split is empty."""
    train = data.of_scenes(scenes_of_split(InputReader(release_dir, scheme), Split.TRAIN.value))
    if not train.any():
        raise TrainingError(f"{release_dir}: the train split of scheme {scheme.value} has 0 candidates, must have at least 1")
    return fit_trees(data.geometry[train], _rows(data.labels, train), variant, seed)


def predicted(trees: Trees, data: TreeData, seed: int) -> pa.Table:
    """Rows of `predictions` for every candidate, by trees that were fitted with a seed."""
    return _predictions(data.inputs, trees.log_probabilities(data.geometry), trees.variant, seed)


def split_predictions(
    release_dir: Path, data: TreeData, variant: TreeVariant, seed: int, scheme: SplitScheme = SplitScheme.SCENE
) -> pa.Table:
    """Rows of `predictions` for every candidate, by trees that saw the train split of a scheme alone."""
    return predicted(split_trees(release_dir, data, variant, seed, scheme), data, seed)


def cross_validated_predictions(data: TreeData, variant: TreeVariant, seed: int, n_folds: int) -> pa.Table:
    """Rows of `predictions` for every candidate, each by trees that saw none of its scene.

    Scenes are dealt to folds in the order of their hash, so that a fold depends on which scenes there are and on nothing else.

    Raises:
        SettingsError: fewer than 2 folds or more folds than scenes.
    """
    if not 2 <= n_folds <= len(data.scene_ids):
        raise SettingsError(f"folds: {n_folds}, must be in [2, {len(data.scene_ids)}], the number of scenes")
    dealt = sorted(data.scene_ids, key=lambda scene_id: order_key(seed, "tree-folds", scene_id))
    log_p = np.zeros((2, len(data.geometry)))
    for fold in range(n_folds):
        held_out = data.of_scenes(dealt[fold::n_folds])
        trees = fit_trees(data.geometry[~held_out], _rows(data.labels, ~held_out), variant, seed)
        log_p[:, held_out] = trees.log_probabilities(data.geometry[held_out])
    return _predictions(data.inputs, log_p, variant, seed)


def _columns_of(variant: TreeVariant) -> list[int]:
    number_of = {feature.name: k for k, feature in enumerate(FEATURES)}
    return [number_of[feature.name] for feature in variant.features]


def _rows(labels: Labels, rows: Bool[np.ndarray, "c"]) -> Labels:
    return Labels(labels.y_plan[rows], labels.y_pipe[rows])


def _predictions(inputs: ReleaseInputs, log_p: Float[np.ndarray, "2 c"], variant: TreeVariant, seed: int) -> pa.Table:
    return prediction_table(variant.value, seed, inputs.candidate_ids, *log_p)
