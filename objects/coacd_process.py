"""CoACD in a process of its own, so that a geometry that makes it abort, or never end, becomes an error; see decomposition.py."""

from __future__ import annotations

import os
import pickle
import select
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
import psutil
import trimesh
from jaxtyping import Float

from objects.errors import MeshError

# What one object may take; the slowest packaged mug takes two. Time of its cores, so that a busy machine refuses nothing.
MAX_CORE_S = 45.0
_TELL_EVERY_S = 10.0


class CoacdProcess:
    """A child process that splits meshes until the context ends; it is started by the first call.

    Args:
        object_id: who is named in errors.
        progress: is told every ten seconds how long a call has taken.
        max_core_s: time of the child's cores at which it is ended.
    """

    def __init__(self, object_id: str, progress: Callable[[str], Any] | None = None, max_core_s: float = MAX_CORE_S) -> None:
        self._object_id, self._progress, self._max_core_s = object_id, progress, max_core_s
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> CoacdProcess:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._child is not None:
            assert self._child.stdin is not None
            assert self._child.stdout is not None
            self._child.stdin.close()
            self._child.stdout.close()
            self._child.wait()

    def split(self, meshes: Sequence[trimesh.Trimesh], **settings: Any) -> list[Float[np.ndarray, "v 3"]]:
        """Vertices of the convex parts of each mesh in turn.

        Args:
            settings: arguments of `coacd.run_coacd`.

        Raises:
            MeshError: CoACD crashed or took too long.
        """
        if self._child is None:
            self._child = _started()
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        pieces = [(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)) for mesh in meshes]
        try:
            _send(self._child.stdin, (pieces, settings))
            self._wait(self._child)
            parts: list[Float[np.ndarray, "v 3"]] = pickle.load(self._child.stdout)
        except (EOFError, BrokenPipeError, pickle.UnpicklingError) as error:
            code = self._child.wait()
            raise MeshError(
                f"{self._object_id}: CoACD crashed with exit code {code}, must be 0; the mesh has degenerate or self-touching faces"
            ) from error
        return parts

    def _wait(self, child: subprocess.Popen[bytes]) -> None:
        """Until the child answers or ends, or has to be ended."""
        assert child.stdout is not None
        start = told = time.monotonic()
        while not select.select([child.stdout], [], [], 0.5)[0]:
            times = psutil.Process(child.pid).cpu_times()
            if (core_s := times.user + times.system) > self._max_core_s:
                child.kill()
                raise MeshError(
                    f"{self._object_id}: CoACD took {core_s:.0f} core-seconds without an end, must be at most {self._max_core_s:g}:"
                    " the mesh is too rough for convex parts; smooth it, or set max_faces"
                )
            if self._progress is not None and time.monotonic() - told >= _TELL_EVERY_S:
                told = time.monotonic()
                self._progress(f"{self._object_id}: CoACD has been at it for {told - start:.0f} s")


def serve() -> None:
    """Answer requests on standard input until it closes."""
    import coacd

    # CoACD writes to standard output whatever its log level: keep the real one for the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    coacd.set_log_level("off")
    while True:
        try:
            pieces, settings = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        _send(answers, [part for vertices, faces in pieces for part, _ in coacd.run_coacd(coacd.Mesh(vertices, faces), **settings)])


def _started() -> subprocess.Popen[bytes]:
    root = str(Path(__file__).parents[1])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.Popen(
        [sys.executable, "-c", "from objects.coacd_process import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": path},
    )


def _send(stream: BinaryIO | Any, message: Any) -> None:
    pickle.dump(message, stream, protocol=pickle.HIGHEST_PROTOCOL)
    stream.flush()
