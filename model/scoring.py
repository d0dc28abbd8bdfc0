"""What a trained ranker says of every candidate, and how long it takes to say it; the scores are judged in reports.

`python -m model.scoring --release DIR --checkpoint DIR --out predictions.parquet`
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import torch
from jaxtyping import Float, Int

from model.checkpoint import load_checkpoint
from model.decision_times import N_TIMED_SCENES, DecisionTime, machine_name, timed_groups
from model.determinism import deterministic, device_named
from model.errors import CheckpointError, InputError, RankerError, SettingsError
from model.grouping import Grouping
from model.inputs import InputReader, ReleaseInputs, read_inputs, scenes_of_split
from model.networks import Network, encode
from model.outputs import check_writable, writing
from model.predictions import prediction_table, write_predictions
from model.ranker import Prediction
from model.release_tables import published_sha256, release_hash
from tables.store import sidecar_path

_GROUPS_AT_ONCE = 32  # bounds memory; a cloud's feature does not depend on which clouds share its batch


def score(release_dir: Path, checkpoint_dir: Path, device: str = "auto", splits: Sequence[str] | None = None) -> pa.Table:
    """Rows of `predictions` for the candidates of a release.

    Args:
        splits: of the scheme that the ranker was trained under, whose candidates are scored; all without it.

    Raises:
        RankerError: the release lacks an input or holds an impossible value, the checkpoint is not one, or a score is not finite.
    """
    ranker, identity, _ = load_checkpoint(checkpoint_dir)
    reader = InputReader(release_dir, identity.split_scheme)
    scenes = None if splits is None else [scene_id for split in splits for scene_id in scenes_of_split(reader, split)]
    inputs = read_inputs(reader, scenes)
    published_sha256(release_dir, reader.selected)
    if not inputs.candidate_ids:
        raise InputError(f"{release_dir}/candidates.parquet: no candidates to score, must have at least 1")
    release = encode(inputs, identity.settings, identity.variant)
    chosen_device = device_named(device)
    with deterministic(identity.settings, chosen_device):
        prediction = predict(ranker.to(chosen_device), release, np.arange(len(release.group_scene)))
    columns = {name: getattr(prediction, name).cpu().numpy() for name in ("log_p_plan", "log_p_exec")}
    for name, values in columns.items():
        for k in np.flatnonzero(~np.isfinite(values))[:1]:
            raise CheckpointError(f"{checkpoint_dir}: {name} of {inputs.candidate_ids[k]} is {values[k]}, must be finite; train again")
    return prediction_table(identity.variant.value, identity.seed, inputs.candidate_ids, columns["log_p_plan"], columns["log_p_exec"])


def predict(ranker: Network, release: Grouping, groups: Int[np.ndarray, "g"]) -> Prediction:
    """Prediction for the candidates of some groups, in order, without dropout and gradients, in float32."""
    device = next(ranker.parameters()).device
    was_training = ranker.training
    ranker.eval()
    with torch.inference_mode():
        parts = [ranker(release.network_input(some, device)) for some in _chunks(groups)]
    ranker.train(was_training)
    plan = [part.plan_logit for part in parts if part.plan_logit is not None]
    execution = [part.exec_logit for part in parts]
    return Prediction(torch.cat(plan) if plan else None, torch.cat(execution))


def decision_times(
    release_dir: Path, checkpoint_dir: Path, split: str = "test", n_scenes: int = N_TIMED_SCENES, device: str = "auto"
) -> list[DecisionTime]:
    """Decision time of the joint group and of every fixed-target group of the first `n_scenes` scenes of a split of the ranker's scheme.

    Wall-clock, one group at a time, the device synchronised before and after.
    """
    ranker, identity, _ = load_checkpoint(checkpoint_dir)
    chosen_device = device_named(device)
    ranker = ranker.to(chosen_device)
    reader = InputReader(release_dir, identity.split_scheme)
    inputs = read_inputs(reader, scenes_of_split(reader, split)[:n_scenes])
    with deterministic(identity.settings, chosen_device):
        return timed_groups(inputs, lambda group: _timed(ranker, group))


def timing_machine(device: str = "auto") -> str:
    """The machine that decides: its processor, and the accelerator where a network would run on one."""
    chosen_device = device_named(device)
    return machine_name() + (f", {torch.cuda.get_device_name(chosen_device)}" if chosen_device.type == "cuda" else "")


def _timed(ranker: Network, inputs: ReleaseInputs) -> tuple[float, float]:
    """(seconds to prepare, seconds to run the network)."""
    device = next(ranker.parameters()).device
    start_s = time.perf_counter()
    release = encode(inputs, ranker.settings, ranker.variant)
    x = release.network_input(np.arange(len(release.group_scene)), device)
    _synchronise(device)
    prepared_s = time.perf_counter()
    with torch.inference_mode():
        ranker(x).score.cpu()
    _synchronise(device)
    return prepared_s - start_s, time.perf_counter() - prepared_s


def _synchronise(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _chunks(groups: Int[np.ndarray, "g"]) -> list[Int[np.ndarray, "_k"]]:
    return [groups[first : first + _GROUPS_AT_ONCE] for first in range(0, len(groups), _GROUPS_AT_ONCE)]


def success_at_1(score: Float[np.ndarray, "c"], success: np.ndarray, group: Int[np.ndarray, "c"]) -> tuple[float | None, int]:
    """(share of covered groups whose best-scored candidate succeeds, covered groups); None where no group is covered.

    A tie goes to the first candidate, which is the lowest grasp and target id.
    """
    order = np.lexsort((np.arange(len(score)), -score, group))
    numbers, first = np.unique(group[order], return_index=True)
    is_covered = np.isin(numbers, group[success])
    hits = success[order[first]][is_covered]
    return (float(hits.mean()) if len(hits) else None), len(hits)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m model.scoring", description="Score every candidate of a release with a trained ranker."
    )
    parser.add_argument("--release", type=Path, required=True, help="folder with <table>.parquet")
    parser.add_argument("--checkpoint", type=Path, required=True, help="folder that model.training wrote")
    parser.add_argument("--out", type=Path, required=True, help="Parquet file of predictions to write")
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda")
    parser.add_argument("--time", type=int, metavar="SCENES", default=0, help="also measure decision times on this many test scenes")
    options = parser.parse_args(arguments)
    times: list[DecisionTime] = []
    try:
        if options.time < 0:
            raise SettingsError(f"--time: {options.time} scenes, must be at least 0")
        for path in (options.out, sidecar_path(options.out)):
            check_writable(path)
        predictions = score(options.release, options.checkpoint, options.device)
        _, identity, _ = load_checkpoint(options.checkpoint)
        of_release = release_hash(options.release)
        if options.time:
            times = decision_times(options.release, options.checkpoint, n_scenes=options.time, device=options.device)
        with writing(options.out):
            write_predictions(predictions, options.out, identity.split_scheme, of_release)
    except RankerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{options.out}: {predictions.num_rows} candidates scored")
    _print_times(times)
    return 0


def _print_times(times: list[DecisionTime]) -> None:
    for task in ("joint", "fixed"):
        mine = [t for t in times if t.task == task]
        if mine:
            prepare_ms, forward_ms, n = (1e3 * np.mean([t.prepare_s for t in mine]), 1e3 * np.mean([t.forward_s for t in mine]), len(mine))
            print(f"{task}: {prepare_ms + forward_ms:.1f} ms a group (prepare {prepare_ms:.1f}, forward {forward_ms:.1f}) over {n} groups")


if __name__ == "__main__":
    sys.exit(main())
