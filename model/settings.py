"""What a training run may choose, each with its reason; the recipe of the labels and the split are not among it."""

from __future__ import annotations

import math
import typing
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any, TypeVar

from model.errors import SettingsError
from tables.vocabulary import SplitScheme

S = TypeVar("S", bound="TrainingSettings")

# Under this name the sidecar of a table of predictions says which split scheme its rankers were trained under; without it, the paper's.
SCHEME_OF_PREDICTIONS = "split_scheme"


class Variant(StrEnum):
    """The paper's ranker and its three ablations, then our networks in the frame of the hand (local_ranker.py)."""

    FULL = "full"
    DIRECT = "direct"  # one head for final success, trained on all candidates
    NO_OBJECT_RELATIVE = "no_object_relative"  # the branch's 128 numbers are zero, every width stays
    NO_TARGET_HYPOTHESIS = "no_target_hypothesis"  # the cloud without the virtual target copy, nothing else changes
    LOCAL = "local"  # what the hand of each candidate meets at the place
    POSE_ONLY = "pose_only"  # the same network on poses alone, those at the place among them, without any point

    @property
    def is_local(self) -> bool:
        return self in (Variant.LOCAL, Variant.POSE_ONLY)


# Far beyond any use; a checkpoint whose sizes were edited must not ask for more memory than there is.
WIDEST, MOST_LAYERS, MOST_FREQUENCIES = 4096, 8, 16


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """What every training chooses, whatever it trains: dropout, loss weights and optimisation."""

    name: str = "full"
    dropout: float = 0.2  # on the fusion layers: candidates of one scene share the cloud, so scenes are memorised quickly

    # The loss: 2 planning + 1 execution + 0.1 ranking.
    weight_plan: float = 2.0
    weight_exec: float = 1.0
    weight_rank: float = 0.1

    # How many of the training scenes are seen: the first in the order of their hash, so that more hold the fewer; 0: all.
    n_train_scenes: int = 0

    # Optimisation.
    n_epochs: int = 40
    scenes_per_batch: int = 4  # whole scenes, about 32 clouds and 800 candidates, so that joint groups are complete
    learning_rate: float = 1e-3
    warmup_share: float = 0.05  # share of all steps
    weight_decay: float = 1e-2
    max_gradient_norm: float = 1.0
    use_bfloat16: bool = True  # on CUDA only, in training only: scoring is float32 everywhere
    n_cpu_threads: int = 0  # 0 leaves it to torch: on CUDA it decides nothing

    def __post_init__(self) -> None:
        for field, value in asdict(self).items():
            numbers = value if isinstance(value, tuple) else (value,)
            if not all(math.isfinite(number) for number in numbers if isinstance(number, float)):
                raise SettingsError(f"{field}: {value}, must be finite")
        check_positive(self, ("n_epochs", "scenes_per_batch", "learning_rate", "max_gradient_norm"))
        for field in ("weight_plan", "weight_exec", "weight_rank", "weight_decay", "n_cpu_threads", "n_train_scenes"):
            if not getattr(self, field) >= 0:
                raise SettingsError(f"{field}: {getattr(self, field)}, must be at least 0")
        for field, low, high in (("dropout", 0.0, 1.0), ("warmup_share", 0.0, 1.0)):
            if not low <= getattr(self, field) < high:
                raise SettingsError(f"{field}: {getattr(self, field)}, must be in [{low}, {high})")


def check_positive(settings: TrainingSettings, fields: Sequence[str]) -> None:
    """Raise SettingsError for the first field that is not above 0."""
    for field in fields:
        if not getattr(settings, field) > 0:
            raise SettingsError(f"{field}: {getattr(settings, field)}, must be above 0")


@dataclass(frozen=True, slots=True)
class RankerSettings(TrainingSettings):
    """Sizes of the paper's network and its fixed normalisation. The defaults are the `full` setting."""

    # The cloud. A quarter of the points a type: sampled uniformly, nearly all would lie on the table, which is the same in every scene.
    n_points: int = 1024
    n_centres_1: int = 256
    n_neighbours_1: int = 32
    radius_1_m: float = 0.08  # a hand's width: the local shape a finger meets
    n_centres_2: int = 64
    n_neighbours_2: int = 32
    radius_2_m: float = 0.20  # an object and what stands next to it
    crop_centre_m: tuple[float, float, float] = (0.5, 0.0, 0.2)  # middle of the table area within reach
    crop_half_m: tuple[float, float, float] = (0.6, 0.7, 0.6)  # environment points further out cannot touch hand or object

    # Normalisation: constants and not statistics, so that a checkpoint means the same on every release.
    workspace_centre_m: tuple[float, float, float] = (0.5, 0.0, 0.1)
    workspace_scale_m: float = 0.5  # brings positions within reach to about [-1, 1]
    hand_scale_m: float = 0.1  # an object's offset from the grasp frame is at most its half length

    # The network. Feature sizes 512, 256, 128, 128 and the fusion 1024 -> 512 -> 256 belong to the architecture and are not settings.
    widths_1: tuple[int, ...] = (64, 64, 128)
    widths_2: tuple[int, ...] = (128, 128, 256)
    width_global: int = 256
    n_type_features: int = 8
    # Finest wave 50 cm in the workspace and 10 cm in the hand. On 36 and on 150 synthetic training scenes the validation loss was lowest
    # with 2, then 4, then 6 octaves: finer waves memorise target poses, and the layers behind resolve more than a wave.
    n_frequencies: int = 2
    # The grasp branch reads the pose of the hand at the place, composed of the same inputs, instead of that at the grasp: not the paper's.
    is_grasp_at_place: bool = False

    def __post_init__(self) -> None:
        TrainingSettings.__post_init__(self)
        check_positive(self, _POSITIVE)
        if self.n_points % 4 or self.n_points > 16_384:
            raise SettingsError(f"n_points: {self.n_points}, must be a multiple of 4 (one quarter a point type) and at most 16384")
        for field, bound in (("n_centres_1", self.n_points * 3 // 4), ("n_centres_2", self.n_centres_1)):
            if getattr(self, field) > bound:
                raise SettingsError(f"{field}: {getattr(self, field)}, must be at most {bound}")
        for field in ("crop_centre_m", "crop_half_m", "workspace_centre_m"):
            if len(getattr(self, field)) != 3:
                raise SettingsError(f"{field}: {getattr(self, field)}, must have 3 numbers")
        for field in ("widths_1", "widths_2"):
            widths = getattr(self, field)
            if not 2 <= len(widths) <= MOST_LAYERS or min(widths) < 1 or max(widths) > WIDEST:
                raise SettingsError(f"{field}: {widths}, must be 2 to {MOST_LAYERS} widths of 1 to {WIDEST}")
        for field, most in (("width_global", WIDEST), ("n_type_features", WIDEST), ("n_frequencies", MOST_FREQUENCIES)):
            if getattr(self, field) > most:
                raise SettingsError(f"{field}: {getattr(self, field)}, must be at most {most}")


_POSITIVE = (
    *("n_points", "n_centres_1", "n_neighbours_1", "radius_1_m", "n_centres_2", "n_neighbours_2", "radius_2_m"),
    *("workspace_scale_m", "hand_scale_m", "width_global", "n_type_features", "n_frequencies"),
)

FULL = RankerSettings()

# For `mini` on two CPU cores: an eighth of the neighbourhoods and half the widths, so that 12 scenes train in well under a minute.
LIGHT = RankerSettings(
    name="light",
    n_points=512,
    n_centres_1=128,
    n_neighbours_1=16,
    radius_1_m=0.10,  # fewer points need a wider ball to find as many neighbours
    n_centres_2=32,
    n_neighbours_2=16,
    radius_2_m=0.25,
    widths_1=(32, 32, 64),
    widths_2=(64, 64, 128),
    width_global=128,
    dropout=0.3,  # few scenes are memorised sooner
    n_epochs=24,
    scenes_per_batch=1,  # six to fifty training scenes: more, smaller steps
    use_bfloat16=False,
    # One: sums come out the same on every machine, and on a busy machine two threads that wait for each other took three times as long.
    n_cpu_threads=1,
)

# For `full` on two CPU cores: the largest network that trains in about half an hour a seed on one core, 757 scenes an epoch.
CPU = replace(LIGHT, name="cpu", dropout=0.2, n_epochs=24, scenes_per_batch=2)
CPU_PLACE = replace(CPU, name="cpu_place", is_grasp_at_place=True)


def variant_named(name: str) -> Variant:
    """The variant of that name; raises SettingsError on another name."""
    try:
        return Variant(name)
    except ValueError:
        raise SettingsError(f"variant {name!r}, must be one of {[v.value for v in Variant]}") from None


def scheme_named(name: str) -> SplitScheme:
    """The split scheme of that name; raises SettingsError on another name."""
    try:
        return SplitScheme(name)
    except ValueError:
        raise SettingsError(f"split {name!r}, must be one of {[s.value for s in SplitScheme]}") from None


def check_seed(seed: int) -> None:
    """Raise SettingsError on a seed that the `predictions` table, where it is a 32-bit number, cannot hold."""
    if not isinstance(seed, int) or isinstance(seed, bool) or not -(2**31) <= seed < 2**31:
        raise SettingsError(f"seed: {seed!r}, must be a whole number in [{-(2**31)}, {2**31 - 1}]")


# Younger than the format of checkpoints: one that does not say was trained so.
_YOUNGER: Mapping[str, Any] = {"n_train_scenes": 0, "is_grasp_at_place": False}


def settings_to_dict(settings: TrainingSettings) -> dict[str, Any]:
    """Plain values that JSON holds."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(settings).items()}


def settings_from_dict(kind: type[S], values: Mapping[str, Any]) -> S:
    """Inverse of `settings_to_dict`; raises SettingsError on an unknown or missing name or a value of another type."""
    kinds = typing.get_type_hints(kind)
    values = {name: value for name, value in _YOUNGER.items() if name in kinds} | dict(values)
    if set(values) != set(kinds):
        raise SettingsError(f"settings {sorted(set(values) ^ set(kinds))} are unknown or missing")
    return kind(**{name: _typed(name, of, values[name]) for name, of in kinds.items()})


def _typed(name: str, kind: Any, value: Any) -> Any:
    if typing.get_origin(kind) is tuple:
        return tuple(_typed(name, typing.get_args(kind)[0], number) for number in value)
    allowed = (int, float) if kind is float else (kind,)
    if not isinstance(value, allowed) or (isinstance(value, bool) and kind is not bool):
        raise SettingsError(f"{name}: {value!r}, must be {kind.__name__}")
    return kind(value)
