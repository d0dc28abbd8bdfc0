"""A trained ranker on disk: weights in safetensors, everything else in JSON written last; and the state a killed training resumes from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch

from model.errors import CheckpointError, RankerError, one_line
from model.inputs import KEY_COLUMNS, column_errors, contract_hash
from model.networks import Network, build_network, settings_kind
from model.outputs import check_writable, writing
from model.release_tables import manifest_sha256, published_sha256
from model.settings import TrainingSettings, Variant, check_seed, scheme_named, settings_from_dict, settings_to_dict, variant_named
from tables.schemas import SCHEMA_VERSION
from tables.store import file_sha256, write_bytes_atomically, write_text_atomically
from tables.vocabulary import SplitScheme

FORMAT_VERSION = 1

RESUME = "resume.safetensors"

_WEIGHTS, _DESCRIPTION = "ranker.safetensors", "ranker.json"
# Columns that were read and the hash of the description itself are younger than the format: a checkpoint without them can be scored.
_INPUT_COLUMNS, _OWN_SHA256 = "input_columns", "description_sha256"

Weights = dict[str, torch.Tensor]


@dataclass(frozen=True, slots=True)
class TrainingIdentity:
    """What decides a training: two with the same identity give the same weights on the same kind of machine."""

    variant: Variant
    seed: int
    settings: TrainingSettings
    release_sha256: str  # of the tables that are read: inputs, labels, splits
    manifest_sha256: str | None  # of manifest.json in the release; null for a folder without one
    split_scheme: SplitScheme = SplitScheme.SCENE  # younger than the format: a checkpoint that does not say was trained under the paper's

    def __post_init__(self) -> None:
        check_seed(self.seed)


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training came: epochs done, the best of them and how it was chosen."""

    n_epochs_done: int
    best_epoch: int
    selected_by: str
    history: tuple[dict[str, Any], ...]

    def __post_init__(self) -> None:
        if self.n_epochs_done != len(self.history):
            raise CheckpointError(f"progress: {self.n_epochs_done} epochs done, {len(self.history)} in the history, must be equal")
        if self.best_epoch not in range(self.n_epochs_done):
            raise CheckpointError(f"progress: best epoch {self.best_epoch}, must be in [0, {self.n_epochs_done})")


def identity_of(
    release_dir: Path, variant: Variant, seed: int, settings: TrainingSettings, scheme: SplitScheme = SplitScheme.SCENE
) -> TrainingIdentity:
    """Identity of a training on a release; raises InputError where a table is missing or not the one that was published."""
    digest = hashlib.sha256()
    for table, sha256 in published_sha256(release_dir, sorted(KEY_COLUMNS)).items():
        digest.update(f"{table}:{sha256}\n".encode())
    return TrainingIdentity(variant, seed, settings, digest.hexdigest(), manifest_sha256(release_dir), scheme)


def check_checkpoint_writable(directory: Path) -> None:
    """Raise OutputError where a checkpoint could not be written into `directory`; makes nothing."""
    for name in (_WEIGHTS, _DESCRIPTION, RESUME):
        check_writable(directory / name)


def save_checkpoint(
    directory: Path,
    identity: TrainingIdentity,
    progress: Progress,
    weights: Mapping[str, torch.Tensor],
    input_columns: Mapping[str, Collection[str]],
) -> None:
    """Publish the weights, then the description that names their SHA-256.

    Args:
        input_columns: the columns that the training read as inputs, by table (InputReader.selected).
    """
    _write_tensors(directory / _WEIGHTS, weights)
    described = _description(identity, progress) | {
        "weights_sha256": file_sha256(directory / _WEIGHTS),
        _INPUT_COLUMNS: {table: list(columns) for table, columns in input_columns.items()},
    }
    described[_OWN_SHA256] = _sha256_of(described)
    with writing(directory / _DESCRIPTION):
        write_text_atomically(directory / _DESCRIPTION, json.dumps(described, indent=2, allow_nan=False) + "\n")


def load_checkpoint(directory: Path) -> tuple[Network, TrainingIdentity, Progress]:
    """The ranker of a checkpoint, ready to score.

    Raises:
        CheckpointError: missing, changed on disk, of sizes that its weights do not have, or trained under another input contract or format.
    """
    path = directory / _DESCRIPTION
    described = _read_description(directory)
    identity, progress = _parsed(path, described)
    weights = _read_weights(directory / _WEIGHTS, str(described.get("weights_sha256")))
    ranker = build_network(identity.settings, identity.variant, None)
    check_weights(ranker, weights, directory / _WEIGHTS)
    ranker.load_state_dict(weights)
    found = _sha256_of(described)
    # Last: a size that does not fit the weights is named above; this finds what weights cannot tell, such as another number of points.
    if described.get(_OWN_SHA256, found) != found:
        raise CheckpointError(f"{path}: SHA-256 {found[:12]}, it says {str(described[_OWN_SHA256])[:12]}; it was changed after training")
    return ranker.eval(), identity, progress


def is_checkpoint_of(directory: Path, identity: TrainingIdentity) -> bool:
    """Whether a folder holds the checkpoint of a training, whole; the texts of the release may have been rendered again since.

    Raises:
        CheckpointError: there is one, and it is damaged or of another contract or format.
    """
    if not (directory / _DESCRIPTION).exists():
        return False
    _, theirs, _ = load_checkpoint(directory)
    return replace(theirs, manifest_sha256=identity.manifest_sha256) == identity


def weights_sha256(directory: Path) -> str:
    """SHA-256 of the weights of a checkpoint; raises CheckpointError where there are none."""
    path = directory / _WEIGHTS
    if not path.exists():
        raise CheckpointError(_missing(path))
    return file_sha256(path)


def input_errors(directory: Path) -> list[str]:
    """What is wrong with the columns that a checkpoint says its training read as inputs; empty where they are the contract exactly.

    Each column that is forbidden, unknown or missing is named with its table; so is a checkpoint that records none or cannot be read.
    """
    path = directory / _DESCRIPTION
    try:
        described = _read_description(directory)
        identity, _ = _parsed(path, described)
    except CheckpointError as error:
        return [str(error)]
    selected = described.get(_INPUT_COLUMNS)
    if not selected:
        return [f"{path}: {_INPUT_COLUMNS} is missing or empty, must name the columns that the training read"]
    if not isinstance(selected, dict) or not all(_is_list_of_names(columns) for columns in selected.values()):
        return [f"{path}: {_INPUT_COLUMNS} must map each table to a list of column names"]
    return column_errors(selected, identity.split_scheme)


def check_weights(ranker: Network, weights: Mapping[str, torch.Tensor], path: Path) -> None:
    """Raise CheckpointError where weights read from `path` are not finite or do not fit a ranker."""
    expected = ranker.state_dict()
    strange = sorted(expected.keys() ^ weights.keys())
    if strange:
        problem = "missing from" if strange[0] in expected else "not a weight of"
        raise CheckpointError(f"{path}: {strange[0]} is {problem} a ranker of variant {ranker.variant.value} with its settings")
    for name, tensor in weights.items():
        mine, theirs = (f"{t.dtype} {list(t.shape)}" for t in (tensor, expected[name]))
        if mine != theirs:
            raise CheckpointError(f"{path}: {name} is {mine}, its settings need {theirs}")
        if not bool(torch.isfinite(tensor).all()):
            raise CheckpointError(f"{path}: {name} has values that are not finite, must have 0")


def save_resume_state(directory: Path, identity: TrainingIdentity, progress: Progress, tensors: Mapping[str, torch.Tensor]) -> None:
    """Publish all that the next epoch needs in one file, so that a kill leaves the state of this epoch or that of the last one."""
    _write_tensors(directory / RESUME, tensors, {"description": json.dumps(_description(identity, progress), allow_nan=False)})


def load_resume_state(directory: Path, identity: TrainingIdentity) -> tuple[Progress, Weights] | None:
    """State of this very training, or None where there is none; the state of another training is no state.

    Raises:
        CheckpointError: the file is not a resume state.
    """
    path = directory / RESUME
    try:
        if not path.exists():
            return None
        with safetensors.safe_open(path, framework="pt") as stored:
            description = (stored.metadata() or {}).get("description", "")
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 (not a mapping)
    except (safetensors.SafetensorError, OSError) as error:
        raise CheckpointError(f"{path}: not a resume state ({one_line(error)}); delete it to start afresh") from error
    theirs, progress = _parsed(path, _json_object(path, description))
    return (progress, tensors) if theirs == identity else None


def drop_resume_state(directory: Path) -> None:
    with writing(directory / RESUME):
        (directory / RESUME).unlink(missing_ok=True)


def _description(identity: TrainingIdentity, progress: Progress) -> dict[str, Any]:
    return {
        "format_version": FORMAT_VERSION,
        "contract_hash": contract_hash(),
        "schema_version": SCHEMA_VERSION,
        "torch_version": torch.__version__,
        "identity": {**asdict(identity), "variant": identity.variant.value, "settings": settings_to_dict(identity.settings)},
        "progress": asdict(progress),
    }


def _sha256_of(described: Mapping[str, Any]) -> str:
    """SHA-256 of a description without its own hash, independent of spaces and of the order of names."""
    content = {name: value for name, value in described.items() if name != _OWN_SHA256}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _read_description(directory: Path) -> dict[str, Any]:
    path = directory / _DESCRIPTION
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise CheckpointError(_missing(path)) from error
    except (OSError, UnicodeDecodeError) as error:
        raise CheckpointError(f"{path}: not a checkpoint ({one_line(error)})") from error
    return _json_object(path, text)


def _json_object(path: Path, text: str) -> dict[str, Any]:
    try:
        described = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: not a checkpoint ({one_line(error)})") from error
    if not isinstance(described, dict):
        raise CheckpointError(f"{path}: not a checkpoint (a JSON {type(described).__name__}, must be an object)")
    return described


def _parsed(path: Path, described: Mapping[str, Any]) -> tuple[TrainingIdentity, Progress]:
    try:
        for name, expected in (("format_version", FORMAT_VERSION), ("contract_hash", contract_hash())):
            if described[name] != expected:
                raise CheckpointError(f"{name} is {described[name]}, must be {expected}")
        identity, progress = described["identity"], described["progress"]
        variant = variant_named(identity["variant"])
        parsed = {
            "variant": variant,
            "settings": settings_from_dict(settings_kind(variant), identity["settings"]),
            "split_scheme": scheme_named(identity.get("split_scheme", SplitScheme.SCENE)),
        }
        return TrainingIdentity(**{**identity, **parsed}), Progress(**{**progress, "history": tuple(progress["history"])})
    except RankerError as error:
        raise CheckpointError(f"{path}: {error}") from error
    except (KeyError, TypeError, OverflowError) as error:
        raise CheckpointError(f"{path}: not a checkpoint ({type(error).__name__}: {one_line(error)})") from error


def _read_weights(path: Path, expected_sha256: str) -> Weights:
    try:
        found = file_sha256(path)
        if found != expected_sha256:
            raise CheckpointError(f"{path}: SHA-256 {found[:12]}, {_DESCRIPTION} says {expected_sha256[:12]}")
        return safetensors.torch.load_file(path)
    except FileNotFoundError as error:
        raise CheckpointError(_missing(path)) from error
    except (safetensors.SafetensorError, OSError) as error:
        raise CheckpointError(f"{path}: not the weights of a ranker ({one_line(error)})") from error


def _missing(path: Path) -> str:
    return f"{path}: missing; train first (python -m model.training)"


def _is_list_of_names(columns: Any) -> bool:
    return isinstance(columns, list) and all(isinstance(column, str) for column in columns)


def _write_tensors(path: Path, tensors: Mapping[str, torch.Tensor], metadata: dict[str, str] | None = None) -> None:
    """Publish a safetensors file: temporary file, fsync, rename."""
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    with writing(path):
        write_bytes_atomically(path, safetensors.torch.save(plain, metadata))
