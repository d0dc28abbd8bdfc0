"""The Dagster UI: `python -m assets_def.ui [--catalogue FILE] [--recipe FILE] [--data FOLDER]`.

Looks at what it is given first: a bad catalogue is one line here, and a page of traceback once Dagster loads the graph.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from assets_def.chosen_dataset import add_choice, environment_of
from assets_def.resources import REPOSITORY
from tables.errors import PlaceBenchError


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Command line: becomes `dagster dev`; exits with 1 where the dataset is not what it should be."""
    parser = argparse.ArgumentParser(prog="python -m assets_def.ui", description=(__doc__ or "").partition("\n")[0])
    add_choice(parser)
    try:
        environment = {**os.environ, **environment_of(parser.parse_args(arguments))}
    except PlaceBenchError as error:
        sys.exit(f"{type(error).__name__}: {error}")
    # Dagster takes the .env of the folder that it starts in over the environment, and that of the checkout names the benchmark's instance.
    os.chdir(environment.get("DAGSTER_HOME", REPOSITORY))
    dagster = str(Path(sys.executable).with_name("dagster"))
    os.execve(dagster, [dagster, "dev", "-m", "assets_def.definitions", "-d", str(REPOSITORY)], environment)


if __name__ == "__main__":
    main()
