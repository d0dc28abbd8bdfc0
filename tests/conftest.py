"""Settings of all tests: how long an example takes is no law of anything, and machines are shared."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("no deadline", deadline=None)
settings.load_profile("no deadline")
