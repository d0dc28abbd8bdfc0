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
N_SCENE_NUMBERS = 10_000  # of a family; a scene id has four digits, and layout.py says which there are
N_TARGETS = 8  # of every scene; a target id is one digit

_SCENE = re.compile(r"(mini|full)-(\d{4})")
_CANDIDATE = re.compile(r"((?:mini|full)-\d{4})-t(\d)-g(\d\d)")
_SHARD = re.compile(r"(mini|full)-\d{3}")


class IdentityError(PlaceBenchError, ValueError):
    """An id that no scene, candidate or shard can have, or that a dataset does not have."""


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
    if family not in FAMILIES:
        raise IdentityError(f"family {family!r}, must be mini or full")
    if not 0 <= index < N_SCENE_NUMBERS:
        raise IdentityError(f"{family}: scene index {index}, must be in [0, {N_SCENE_NUMBERS})")
    return f"{family}-{index:04d}"


def parse_scene_id(scene_id: str) -> tuple[str, int]:
    """(family, index) of a scene id; raises IdentityError on anything else. Whether a dataset has the scene its layout says."""
    match = _SCENE.fullmatch(scene_id)
    if match is None:
        raise IdentityError(f"{scene_id!r} is not a scene id; expected mini-NNNN or full-NNNN")
    return match.group(1), int(match.group(2))


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
    return CandidateId(match.group(1), int(match.group(2)), int(match.group(3)))


def family_of_tier(tier: str) -> str:
    """The family whose scenes a tier holds."""
    if tier not in TIERS:
        raise IdentityError(f"{tier!r} is not a tier; expected mini, pilot or full")
    return "mini" if tier == "mini" else "full"


def family_of_shard(shard: str) -> str:
    """The family whose scenes a shard holds."""
    match = _SHARD.fullmatch(shard)
    if match is None:
        raise IdentityError(f"{shard!r} is not a shard; expected for example mini-000 or full-017")
    return match.group(1)


def number_of_shard(shard: str) -> int:
    """Number of a shard in its family."""
    family_of_shard(shard)
    return int(shard.partition("-")[2])


def _digest(seed: int, stage: str, ids: tuple[str | int, ...]) -> bytes:
    return hashlib.sha256("\x1f".join((str(seed), stage, *map(str, ids))).encode()).digest()
