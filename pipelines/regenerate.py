"""The command `python -m pipelines.regenerate`; see proofs/regenerate.py for what it does."""

from __future__ import annotations

import sys

from pipelines.proofs.regenerate import main

if __name__ == "__main__":
    sys.exit(main())
