"""The conditions under which the network runs: device, deterministic kernels, number of threads; random draws are made elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from model.errors import SettingsError
from model.settings import TrainingSettings


def device_named(name: str) -> torch.device:
    """`auto` is CUDA where there is one; raises SettingsError on a device that is not there."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name not in ("cpu", "cuda"):
        raise SettingsError(f"device {name!r}, must be auto, cpu or cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise SettingsError("device cuda: torch finds no CUDA device")
    return torch.device(name)


@contextmanager
def deterministic(settings: TrainingSettings, device: torch.device) -> Iterator[None]:
    """Deterministic kernels and the number of threads of the settings inside; what the caller had comes back, its random state too."""
    # cuBLAS reads this when its first handle is made; without it deterministic mode refuses matrix products.
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    was_deterministic, n_threads = torch.are_deterministic_algorithms_enabled(), torch.get_num_threads()
    torch.use_deterministic_algorithms(True)
    if settings.n_cpu_threads:
        torch.set_num_threads(settings.n_cpu_threads)
    try:
        with torch.random.fork_rng(devices=[torch.cuda.current_device()] if device.type == "cuda" else []):
            yield
    finally:
        torch.use_deterministic_algorithms(was_deterministic)
        torch.set_num_threads(n_threads)
