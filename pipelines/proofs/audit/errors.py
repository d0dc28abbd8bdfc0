"""The exception of the audits."""

from __future__ import annotations

from tables.errors import PlaceBenchError


class AuditError(PlaceBenchError, RuntimeError):
    """An audit that could not be made; names the scene or candidate and why."""
