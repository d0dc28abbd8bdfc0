"""What the two finger drives are told from tick to tick: speeds, and a grip force that rises and falls; the world is hand_world.py."""

from __future__ import annotations

from dataclasses import dataclass

from pipelines.engines.physics.hand_params import HandWorldParams


@dataclass(slots=True)
class FingerDrives:
    """Both drives do the same.

    Attributes:
        speed_m_s: commanded speed of a finger, positive opens.
        force_n: what each finger presses with now, on top of the servo.
        is_gripping: close at rated speed, and press once both fingers touch.
        has_touched: both touched at the last tick.
    """

    speed_m_s: float = 0.0
    force_n: float = 0.0
    is_gripping: bool = False
    has_touched: bool = False

    def command(self, speed_m_s: float) -> None:
        """A speed; a grip is let go first."""
        self.speed_m_s, self.is_gripping = speed_m_s, False

    def grip(self, params: HandWorldParams) -> None:
        """Close, and press."""
        self.speed_m_s, self.is_gripping = -params.finger_speed_m_s, True

    def hold_on(self, params: HandWorldParams) -> None:
        """Press with the whole grip force at once: a hold that goes on."""
        self.grip(params)
        self.force_n, self.has_touched = params.finger_force_n, True

    def tick(self, touches: bool, params: HandWorldParams) -> tuple[float, float]:
        """Servo speed and pressing force of each finger in the next tick.

        Args:
            touches: whether both fingers pressed on the object in the last step.
        """
        wanted_n = 0.0
        if self.is_gripping:
            if touches or (self.has_touched and self.force_n > 0.0):  # one tick is forgiven: a new model has not felt anything yet
                wanted_n = params.finger_force_n
            elif not self.has_touched:
                self.force_n = 0.0  # nothing to press on: what was held is gone
            self.has_touched = touches
        step_n = params.finger_force_n * params.dt_s / params.grip_ramp_s
        self.force_n += min(step_n, max(-step_n, wanted_n - self.force_n))
        return (0.0 if self.force_n > 0.0 else self.speed_m_s), self.force_n
