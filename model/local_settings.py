"""What a training of our networks in the hand's frame may choose; what every training chooses stands in settings.py."""

from __future__ import annotations

from dataclasses import dataclass

from model.errors import SettingsError
from model.settings import MOST_LAYERS, WIDEST, TrainingSettings, check_positive

MOST_POINTS, MOST_BINS = 4096, 256


@dataclass(frozen=True, slots=True)
class LocalSettings(TrainingSettings):
    """Points that are looked at and sizes of the layers. The defaults are the `full` setting."""

    # What is left of the cloud of a scene, well spread (clouds.farthest_points); the nearest of it are chosen for each candidate.
    n_object_points: int = 48  # only for the gap between obstacles and object at the target
    n_obstacle_points: int = 128  # a box of 10 cm has one every 2 cm
    n_environment_points: int = 48  # the table is flat
    n_near_obstacle: int = 24
    n_near_environment: int = 8

    n_bins: int = 16  # of each feature, see local_ranker.FeatureEncoding
    point_widths: tuple[int, ...] = (32, 64)
    widths: tuple[int, ...] = (256, 128)
    head_width: int = 64
    n_members: int = 8  # see local_ranker.Members
    n_attention_heads: int = 0  # of one attention layer over the candidates of a fixed-target group; 0: none

    def __post_init__(self) -> None:
        TrainingSettings.__post_init__(self)
        counts = ("n_object_points", "n_obstacle_points", "n_environment_points", "n_near_obstacle", "n_near_environment")
        check_positive(self, (*counts, "n_bins", "head_width", "n_members"))
        for field, most in (
            *((count, MOST_POINTS) for count in counts),
            ("n_bins", MOST_BINS),
            ("n_members", MOST_BINS),
            ("head_width", WIDEST),
        ):
            if getattr(self, field) > most:
                raise SettingsError(f"{field}: {getattr(self, field)}, must be at most {most}")
        for field in ("point_widths", "widths"):
            widths = getattr(self, field)
            if not 1 <= len(widths) <= MOST_LAYERS or min(widths) < 1 or max(widths) > WIDEST:
                raise SettingsError(f"{field}: {widths}, must be 1 to {MOST_LAYERS} widths of 1 to {WIDEST}")
        if self.n_attention_heads < 0 or (self.n_attention_heads and self.widths[0] % self.n_attention_heads):
            raise SettingsError(f"n_attention_heads: {self.n_attention_heads}, must be 0 or divide the first of widths, {self.widths[0]}")


FULL = LocalSettings(n_epochs=20, n_cpu_threads=1, use_bfloat16=False)

LIGHT = LocalSettings(
    name="light",
    n_bins=8,
    dropout=0.3,  # few scenes are memorised sooner
    n_epochs=24,
    scenes_per_batch=1,  # six to fifty training scenes: more, smaller steps
    n_cpu_threads=1,  # sums come out the same on every machine
    use_bfloat16=False,
)
