"""The command `python -m pipelines.reproduce`; see proofs/reproduce.py for what it does."""

from __future__ import annotations

import sys

from pipelines.proofs.reproduce import main

if __name__ == "__main__":
    sys.exit(main())
