"""A trained ranker on disk: weights in safetensors, everything else in JSON written last; and the state a killed training resumes from."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch

from model.inputs import KEY_COLUMNS, InputError, contract_hash
from model.ranker import Ranker
from model.settings import RankerError, RankerSettings, Variant, settings_from_dict, settings_to_dict, variant_named
from tables.schemas import SCHEMA_VERSION
from tables.store import file_sha256, write_text_atomically

FORMAT_VERSION = 1

_WEIGHTS, _DESCRIPTION, _RESUME = "ranker.safetensors", "ranker.json", "resume.safetensors"


class CheckpointError(RankerError):
    """A checkpoint that is missing, changed or made under another contract."""


@dataclass(frozen=True, slots=True)
class TrainingIdentity:
    """What decides a training: two with the same identity give the same weights on the same kind of machine."""

    variant: Variant
    seed: int
    settings: RankerSettings
    release_sha256: str  # of the tables that are read: inputs, labels, splits
    manifest_sha256: str | None  # of the release's manifest.json; null for a folder without one


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training came: epochs done, the best of them and how it was chosen."""

    n_epochs_done: int
    best_epoch: int
    selected_by: str
    history: tuple[dict[str, Any], ...]


def identity_of(release_dir: Path, variant: Variant, seed: int, settings: RankerSettings) -> TrainingIdentity:
    """Identity of a training on a release; raises InputError where a table is missing."""
    digest = hashlib.sha256()
    for table in sorted(KEY_COLUMNS):
        path = release_dir / f"{table}.parquet"
        if not path.exists():
            raise InputError(f"{path}: missing; the ranker reads {sorted(KEY_COLUMNS)}")
        digest.update(f"{table}:{file_sha256(path)}\n".encode())
    manifest = release_dir / "manifest.json"
    return TrainingIdentity(variant, seed, settings, digest.hexdigest(), file_sha256(manifest) if manifest.exists() else None)


def save_checkpoint(directory: Path, identity: TrainingIdentity, progress: Progress, weights: Mapping[str, torch.Tensor]) -> None:
    """Publish the weights, then the description that names their SHA-256."""
    _write_tensors(directory / _WEIGHTS, weights)
    described = _description(identity, progress) | {"weights_sha256": file_sha256(directory / _WEIGHTS)}
    write_text_atomically(directory / _DESCRIPTION, json.dumps(described, indent=2, allow_nan=False) + "\n")


def load_checkpoint(directory: Path) -> tuple[Ranker, TrainingIdentity, Progress]:
    """The ranker of a checkpoint, ready to score.

    Raises:
        CheckpointError: missing, changed on disk, or trained under another input contract or format.
    """
    path = directory / _DESCRIPTION
    for needed in (path, directory / _WEIGHTS):
        if not needed.exists():
            raise CheckpointError(f"{needed}: missing; train first (python -m model.training)")
    identity, progress, described = _parsed(path, path.read_text())
    found = file_sha256(directory / _WEIGHTS)
    if found != described.get("weights_sha256"):
        raise CheckpointError(
            f"{directory / _WEIGHTS}: SHA-256 {found[:12]}, {_DESCRIPTION} says {str(described.get('weights_sha256'))[:12]}"
        )
    ranker = Ranker(identity.settings, identity.variant, identity.seed)
    ranker.load_state_dict(safetensors.torch.load_file(directory / _WEIGHTS))
    return ranker.eval(), identity, progress


def save_resume_state(directory: Path, identity: TrainingIdentity, progress: Progress, tensors: Mapping[str, torch.Tensor]) -> None:
    """Publish all that the next epoch needs in one file, so that a kill leaves this epoch's state or the last one's."""
    _write_tensors(directory / _RESUME, tensors, {"description": json.dumps(_description(identity, progress), allow_nan=False)})


def load_resume_state(directory: Path, identity: TrainingIdentity) -> tuple[Progress, dict[str, torch.Tensor]] | None:
    """State of this very training, or None where there is none; another training's state is no state.

    Raises:
        CheckpointError: the file is not a resume state.
    """
    path = directory / _RESUME
    if not path.exists():
        return None
    try:
        with safetensors.safe_open(path, framework="pt") as stored:
            description = (stored.metadata() or {}).get("description", "")
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 (not a mapping)
    except safetensors.SafetensorError as error:
        raise CheckpointError(f"{path}: not a resume state ({error}); delete it to start afresh") from error
    theirs, progress, _ = _parsed(path, description)
    return (progress, tensors) if theirs == identity else None


def drop_resume_state(directory: Path) -> None:
    (directory / _RESUME).unlink(missing_ok=True)


def _description(identity: TrainingIdentity, progress: Progress) -> dict[str, Any]:
    return {
        "format_version": FORMAT_VERSION,
        "contract_hash": contract_hash(),
        "schema_version": SCHEMA_VERSION,
        "torch_version": torch.__version__,
        "identity": {**asdict(identity), "variant": identity.variant.value, "settings": settings_to_dict(identity.settings)},
        "progress": asdict(progress),
    }


def _parsed(path: Path, text: str) -> tuple[TrainingIdentity, Progress, dict[str, Any]]:
    try:
        described = json.loads(text)
        for name, expected in (("format_version", FORMAT_VERSION), ("contract_hash", contract_hash())):
            if described[name] != expected:
                raise CheckpointError(f"{path}: {name} is {described[name]}, must be {expected}")
        identity, progress = described["identity"], described["progress"]
        settings = {"variant": variant_named(identity["variant"]), "settings": settings_from_dict(identity["settings"])}
        return TrainingIdentity(**{**identity, **settings}), Progress(**{**progress, "history": tuple(progress["history"])}), described
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise CheckpointError(f"{path}: not a checkpoint ({type(error).__name__}: {error})") from error


def _write_tensors(path: Path, tensors: Mapping[str, torch.Tensor], metadata: dict[str, str] | None = None) -> None:
    """Publish a safetensors file: temporary file, fsync, rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as handle:
        handle.write(safetensors.torch.save(plain, metadata))
        handle.flush()
        os.fsync(handle.fileno())
    os.chmod(handle.name, 0o644)
    os.replace(handle.name, path)
