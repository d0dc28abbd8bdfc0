"""Refuses to make tables with BLAS kernels whose last bits are not those of every other machine's; why, says tables/__init__.py."""

from __future__ import annotations

import platform

import numpy as np
from threadpoolctl import threadpool_info

from tables import BLAS_KERNELS
from tables.errors import PlaceBenchError


class KernelsError(PlaceBenchError, RuntimeError):
    """OpenBLAS runs other kernels; names them and what to do."""


def check_kernels() -> None:
    """Raise KernelsError where OpenBLAS was loaded with other kernels than `BLAS_KERNELS`; only x86-64 has them."""
    np.linalg.norm(np.ones(2))  # it is loaded by now
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return
    found = sorted({str(pool["architecture"]) for pool in threadpool_info() if pool["internal_api"] == "openblas"})
    if found != [BLAS_KERNELS]:
        raise KernelsError(
            f"OpenBLAS runs the kernels of {', '.join(found) or 'none'}, must be {BLAS_KERNELS}: set OPENBLAS_CORETYPE={BLAS_KERNELS}"
            " before numpy is imported (or import `tables` first)"
        )
