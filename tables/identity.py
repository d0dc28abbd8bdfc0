"""Names and seeds: who a scene, grasp, target or candidate is, and the random numbers its identity entitles it to.

Nothing else in the project may create randomness: a draw depends on the recipe seed, the stage and the identity, never on
order, process or time.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass

import numpy as np

from tables.errors import PlaceBenchError

# Families of scenes, and how much of the benchmark there is: `pilot` is the beginning of the family `full`.
FAMILIES = ("mini", "full")
TIERS = ("mini", "pilot", "full")
SCENES_PER_SHARD = 19
# 1,235 scenes, as many as the paper's, for at least 250,000 candidates at 203 or more a scene (217 on `pilot`). More shards leave every id
# and seed, and the splits of `pilot`, as they are; splits of the other scenes of `full` depend on how many there are, so the number is
# final once `full` is published.
# Not any number will do: at some (66, 69, 74) the split shares of a category miss by more than the one scene that test_scene_groups allows.
N_FULL_SHARDS = 65
N_PILOT_SHARDS = 4
N_MINI_SCENES = 12
N_TARGETS = 8  # of every scene; a target id is one digit

_SCENE = re.compile(r"(mini|full)-(\d{4})")
_CANDIDATE = re.compile(r"((?:mini|full)-\d{4})-t(\d)-g(\d\d)")


class IdentityError(PlaceBenchError, ValueError):
    """An id that no scene, candidate or shard can have."""


def rng_for(seed: int, stage: str, *ids: str | int) -> np.random.Generator:
    """Random generator of one identity in one stage.

    Args:
        seed: the recipe seed.
        stage: name of the stage that draws.
        ids: the identity, for example a scene id and an attempt number.
    """
    return np.random.Generator(np.random.PCG64(int.from_bytes(_digest(seed, stage, ids)[:16], "little")))


def ompl_seed_for(seed: int, stage: str, *ids: str | int) -> int:
    """Seed in [1, 2147483646] for OMPL, which refuses 0 and truncates to 32 bits."""
    return int.from_bytes(_digest(seed, stage, ids)[:8], "little") % 2147483646 + 1


def order_key(seed: int, stage: str, *ids: str | int) -> int:
    """A 63-bit key of one identity; sorting by it is a random order that does not depend on what else is sorted."""
    return int.from_bytes(_digest(seed, stage, ids)[:8], "little") >> 1


def scene_id_of(family: str, index: int) -> str:
    """`full-0042`; family is `mini` or `full`, the index counts from 0 within the family."""
    bound = n_scenes_of(family)
    if not 0 <= index < bound:
        raise IdentityError(f"{family}: scene index {index}, must be in [0, {bound})")
    return f"{family}-{index:04d}"


def parse_scene_id(scene_id: str) -> tuple[str, int]:
    """(family, index) of a scene id; raises IdentityError on anything else."""
    match = _SCENE.fullmatch(scene_id)
    if match is None:
        raise IdentityError(f"{scene_id!r} is not a scene id; expected mini-NNNN or full-NNNN")
    family, index = match.group(1), int(match.group(2))
    scene_id_of(family, index)
    return family, index


def candidate_id_of(scene_id: str, target_id: int, grasp_id: int) -> str:
    """`full-0042-t3-g17`: sorts as (scene_id, target_id, grasp_id)."""
    return f"{scene_id}-t{target_id:d}-g{grasp_id:02d}"


@dataclass(frozen=True, slots=True)
class CandidateId:
    """The three coordinates of a candidate."""

    scene_id: str
    target_id: int
    grasp_id: int


def parse_candidate_id(candidate_id: str) -> CandidateId:
    """The coordinates in a candidate id; raises IdentityError on anything else."""
    match = _CANDIDATE.fullmatch(candidate_id)
    if match is None:
        raise IdentityError(f"{candidate_id!r} is not a candidate id; expected for example full-0042-t3-g17")
    parse_scene_id(match.group(1))
    return CandidateId(match.group(1), int(match.group(2)), int(match.group(3)))


def n_scenes_of(family: str) -> int:
    """Number of scenes in a family: 12 in `mini`, 19 a shard in `full`."""
    if family == "mini":
        return N_MINI_SCENES
    if family == "full":
        return SCENES_PER_SHARD * N_FULL_SHARDS
    raise IdentityError(f"family {family!r}, must be mini or full")


def scenes_of_shard(shard: str) -> tuple[str, ...]:
    """Scene ids of a shard key: `mini-000`, or `full-000` and on with 19 scenes each."""
    family, _, number = shard.partition("-")
    if family == "mini" and number == "000":
        return tuple(scene_id_of("mini", k) for k in range(N_MINI_SCENES))
    if family == "full" and re.fullmatch(r"\d{3}", number) and int(number) < N_FULL_SHARDS:
        first = int(number) * SCENES_PER_SHARD
        return tuple(scene_id_of("full", first + k) for k in range(SCENES_PER_SHARD))
    raise IdentityError(f"{shard!r} is not a shard; expected mini-000 or full-000 to full-{N_FULL_SHARDS - 1:03d}")


def shard_of_scene(scene_id: str) -> str:
    """The shard that a scene belongs to."""
    family, index = parse_scene_id(scene_id)
    return "mini-000" if family == "mini" else f"full-{index // SCENES_PER_SHARD:03d}"


def family_of_tier(tier: str) -> str:
    """The family whose scenes a tier holds."""
    return parse_scene_id(scenes_of_shard(shards_of_tier(tier)[0])[0])[0]


def family_of_shard(shard: str) -> str:
    """The family whose scenes a shard holds."""
    return parse_scene_id(scenes_of_shard(shard)[0])[0]


def shards_of_tier(tier: str) -> tuple[str, ...]:
    """Shard keys of a tier: `mini` has one, `full` has `N_FULL_SHARDS`, of which the first are `pilot`."""
    if tier == "mini":
        return ("mini-000",)
    if tier in ("pilot", "full"):
        return tuple(f"full-{k:03d}" for k in range(N_PILOT_SHARDS if tier == "pilot" else N_FULL_SHARDS))
    raise IdentityError(f"{tier!r} is not a tier; expected mini, pilot or full")


def _digest(seed: int, stage: str, ids: tuple[str | int, ...]) -> bytes:
    return hashlib.sha256("\x1f".join((str(seed), stage, *map(str, ids))).encode()).digest()
