"""What the rows of one object are made from: equal sources give equal rows, so a stored object with the same sources need not be built.

No other object of the catalogue is among the sources. See pipelines/running/object_store.py for where built objects are kept.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from importlib.metadata import version

from objects.build import ObjectParams
from objects.catalogue import ObjectSpec, hashed_entry

# Changes when the code in objects/ may give other rows for the same entry and parameters.
OBJECT_CODE_VERSION = "2"
# What decides vertices, parts, resting poses and grasps: coal tests the clearance of the gripper, trimesh adds up the probabilities of
# resting poses with networkx.
LIBRARIES = ("coacd", "coal", "manifold3d", "networkx", "numpy", "scipy", "trimesh")


def shared_sources(params: ObjectParams, seed: int) -> dict[str, str]:
    """What every object is made from besides its entry: the seed, the parameters, the code and the libraries."""
    return {
        "seed": str(seed),
        # Not with sorted keys: the order in which the kinds of grasp have their shares breaks ties.
        "params": _sha256(json.dumps(dataclasses.asdict(params))),
        "code": OBJECT_CODE_VERSION,
        "libraries": ", ".join(f"{name} {version(name)}" for name in LIBRARIES),
    }


def entry_sha256(spec: ObjectSpec) -> str:
    """SHA-256 of a catalogue entry (see `objects.catalogue.hashed_entry`)."""
    return _sha256(json.dumps(hashed_entry(spec), sort_keys=True))


def object_sources(spec: ObjectSpec, params: ObjectParams, seed: int) -> dict[str, str]:
    """Everything that one object is made from."""
    return {"entry": entry_sha256(spec), **shared_sources(params, seed)}


def catalogue_sources(specs: Sequence[ObjectSpec], params: ObjectParams, seed: int) -> dict[str, str]:
    """Everything that the tables of all objects are made from; the order of the entries is none of it, tables are sorted by id."""
    entries = {spec.object_id: entry_sha256(spec) for spec in specs}
    return {"catalogue": _sha256(json.dumps(entries, sort_keys=True)), **shared_sources(params, seed)}


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
