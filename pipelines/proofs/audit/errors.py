"""The exception of the audits."""

from __future__ import annotations


class AuditError(RuntimeError):
    """An audit that could not be made; names the scene or candidate and why."""
