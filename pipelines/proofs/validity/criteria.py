"""What the numbers of a valid engine must be, and what is reported beside them; measured in the studies, shown by reports.validity."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Criterion:
    """One number: its test, its bounds (None where there is none), the key of its count, and what it means.

    `study` measures it, "" where every study does. `is_share` marks a share of runs, which has a binomial interval.
    """

    study: str
    test: str
    key: str
    count_key: str
    low: float | None
    high: float | None
    meaning: str
    is_share: bool = False

    def holds(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)

    @property
    def bound(self) -> str:
        """The bounds in words."""
        if self.low is not None and self.low == self.high:
            return f"{self.low:g}"
        if self.low is not None and self.high is not None:
            return f"{self.low:g} to {self.high:g}"
        return f">= {self.low:g}" if self.low is not None else f"<= {self.high:g}" if self.high is not None else "–"


_Test = tuple[str, str]  # name of the study, and what it does


def _must(test: _Test, key: str, count_key: str, low: float | None, high: float | None, meaning: str) -> Criterion:
    return Criterion(*test, key, count_key, low, high, meaning, is_share=key.endswith(("_flip", "_right_way", "_agreement")))


def _beside(test: _Test, key: str, count_key: str, meaning: str) -> Criterion:
    return _must(test, key, count_key, None, None, meaning)


_HOLD = "hold_creep", "hold 3 s, every object, hand down"
_MORE_HOLD = "hold_creep_elsewhere", "hold 3 s, every object, hands level and tilted"
_PULL = "pull_out", "pull-out through the pads' centre, flat objects"
_TWIST = "torsion", "torque about the jaw axis, flat objects"
_SLIP = "loads", "transport at <= 25 % of capacity, cans and cuboids"
_LIGHT = "loads", "lost in transport below half of capacity, cans and cuboids"
_AUC, _EVEN = ("loads", "demand ratio and outcome, cuboids"), ("loads", "the same loads against evenly pressed pads")
_ASKEW = "loads", "grips askew, cans and cuboids"
_STEP, _FINER = ("flips", "half the step"), ("flips", "finer pads, 5 x 5 cells")
_FRICTION, _LEVER = ("flips", "friction +-5 %"), ("flips", "lever of the pads +-15 %")
_LIFT = "lifts", "pick-lift"
_AGAIN, _LIFT_AGAIN = (("flips", "run again without a change"), ("lifts", "run again without a change"))
_SECOND = "second_engine", "the other engine with the same pads"
_FAULTS = "", "solver resets and states that are not finite"

CRITERIA = (
    _must(_HOLD, "hold_creep_mm_median", "n_hold_creep", None, 0.05, "millimetres in the hand after the load is taken"),
    _must(_HOLD, "hold_creep_mm_max", "n_hold_creep", None, 0.5, "the worst of these grasps"),
    _must(_PULL, "pullout_ratio_min", "n_pullout", 0.9, 1.1, "force at which it slips, over Coulomb's 2 mu F: the least"),
    _must(_PULL, "pullout_ratio_max", "n_pullout", 0.9, 1.1, "the most"),
    _must(_TWIST, "torsion_lever_ratio_min", "n_torsion", 0.85, 1.15, "torque at which it turns, over 2 mu F x lever: the least"),
    _must(_TWIST, "torsion_lever_ratio_max", "n_torsion", 0.85, 1.15, "the most"),
    _must(_SLIP, "transport_slip_mm_max", "n_transport_slip", None, 0.8, "millimetres that a load moves which sticks by Coulomb"),
    _must(_LIGHT, "light_load_drops", "n_light_load", 0.0, 0.0, "nothing falls or slips that the grip holds twice over"),
    _must(_AUC, "cuboid_auc", "n_cuboid_auc", 0.9, None, "theory without an engine foretells success (area under ROC)"),
    _must(_STEP, "half_step_flip", "n_half_step", None, 0.02, "labels do not hang on the time step"),
    _must(_FRICTION, "friction_flip", "n_friction", None, 0.03, "labels hang little on a number that nobody knows better"),
    _must(_FRICTION, "friction_right_way", "n_friction_flipped", 0.9, None, "of these flips: more friction helps, less of it hurts"),
    _must(_FINER, "finer_pad_flip", "n_finer_pad", None, 0.03, "labels do not hang on the pads' cells"),
    _must(_SECOND, "engine2_agreement", "n_engine2", 0.95, None, "another solver says the same of success"),
    _must(_SECOND, "engine2_kappa", "n_engine2", 0.8, None, "the same beyond chance (Cohen)"),
    _must(_FAULTS, "solver_faults", "n_solver_faults", 0.0, 0.0, "the engine never gave up"),
)

# Reported beside them, without a bound.
BESIDE = (
    _beside(_HOLD, "hold_not_held", "n_hold_tried", "grasps that did not take the load, of those tried; they have no creep"),
    _beside(_HOLD, "hold_objects_short", "n_hold_objects", "objects with fewer grasps that hold than were asked for"),
    _beside(_MORE_HOLD, "hold_creep_any_direction_mm_median", "n_hold_creep_any_direction", "millimetres where gravity pulls another way"),
    _beside(_MORE_HOLD, "hold_creep_any_direction_mm_max", "n_hold_creep_any_direction", "the worst of these grasps"),
    _beside(
        _AUC, "cuboid_held_auc", "n_cuboid_auc", "held to the release (neither dropped nor slipped, however it ended) instead of success"
    ),
    _beside(_ASKEW, "preload_ratio_max", "n_loads", "friction a grip takes by itself, over mu F: Coulomb allows 1"),
    _beside(_EVEN, "transport_slip_even_pads_mm_max", "n_transport_slip_even_pads", "slip at <= 25 %, grips askew among them"),
    _beside(_EVEN, "light_load_drops_even_pads", "n_light_load_even_pads", "lost below half"),
    _beside(_EVEN, "cuboid_auc_even_pads", "n_cuboid_auc", "success foretold"),
    _beside(_SECOND, "engine2_agreement_weighted", "n_engine2", "each candidate counted as what it stands for in the tier"),
    _beside(_SECOND, "engine2_kappa_weighted", "n_engine2", "the same beyond chance"),
    _beside(_SECOND, "rigid_pads_agreement_weighted", "n_engine2", "rigid pads against those that make the labels, one engine"),
    _beside(_FRICTION, "friction_slip_right_way", "n_friction_slip", "slip in the hand, where it differs: more friction slips less"),
    _beside(_LEVER, "pad_lever_up_flip", "n_pad_lever_up", "what a longer lever changes"),
    _beside(_LEVER, "pad_lever_down_flip", "n_pad_lever_down", "what a shorter lever changes"),
    _beside(_LIFT, "lift_half_step_flip", "n_lift_half_step", "lifted or not, at half the step"),
    _beside(_LIFT, "lift_friction_flip", "n_lift_friction", "lifted or not, at friction +-5 %"),
    _beside(_AGAIN, "stored_differs", "n_stored", "executions of another status than the stored one"),
    _beside(_LIFT_AGAIN, "lift_stored_differs", "n_lift_stored", "pick-lifts of another status than the stored one"),
)


def measured_by(criteria: Iterable[Criterion], studies: Collection[str]) -> tuple[Criterion, ...]:
    """Those of some numbers that some studies measure, and those that all do."""
    return tuple(criterion for criterion in criteria if criterion.study in studies or not criterion.study)
