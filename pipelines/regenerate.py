"""The command `python -m pipelines.regenerate`; the work is proofs.regenerate's."""

from __future__ import annotations

import sys

from pipelines.proofs.regenerate import main

if __name__ == "__main__":
    sys.exit(main())
