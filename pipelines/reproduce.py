"""The command `python -m pipelines.reproduce`; the work is proofs.reproduce's."""

from __future__ import annotations

import sys

from pipelines.proofs.reproduce import main

if __name__ == "__main__":
    sys.exit(main())
