"""The results of a release as static pages: `make site TIER=pilot`, then open reports/out/pilot/site/index.html.

`python -m reports.site RELEASE [--reports DIR] [--films DIR] [--out DIR]`

Read are the release, whole or light, the reports that `python -m reports.all` left, and films that `python -m pipelines.regenerate` wrote
as `<candidate id>.gif`, `.png` and `.mcap`. Pages need no server, no build and nothing from elsewhere.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from reports.site.pages import Site
from splits.release_reader import Release, report_folder
from tables.errors import PlaceBenchError
from tables.store import write_bytes_atomically


def write_site(site: Site, out: Path) -> list[Path]:
    """Write the files of a site into a folder, `index.html` last, and take away what a site before left there; returns their paths.

    Raises:
        PlaceBenchError: a table of the release that cannot be read.
    """
    files = site.files()
    if out.exists():
        shutil.rmtree(out)
    for name in sorted(files, key=lambda name: (name == "index.html", name)):
        write_bytes_atomically(out / name, files[name])
    return [out / name for name in sorted(files)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0, or 1 with one line where there is no release, or where the folder holds something that is no site."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m reports.site", description=about, epilog=more.rpartition("\n\n")[2])
    parser.add_argument("release", type=Path, help="folder of a release")
    parser.add_argument(
        "--reports",
        type=Path,
        metavar="DIR",
        help="folder of its reports (reports/out/TIER, or reports/TIER beside an own dataset)",
    )
    parser.add_argument("--films", type=Path, metavar="DIR", help="folder of films (films/ in that of the reports)")
    parser.add_argument("--out", type=Path, help="folder for the pages (site/ in that of the reports)")
    chosen = parser.parse_args(arguments)
    try:
        release = Release.open(chosen.release)
        reports = chosen.reports or report_folder(release)
        out: Path = chosen.out or reports / "site"
        if out.exists() and any(out.iterdir()) and not (out / "site.js").exists():
            print(f"error: {out}: holds something else than a site, must be empty or a site", file=sys.stderr)
            return 1
        paths = write_site(Site(release, reports, chosen.films or reports / "films"), out)
    except (PlaceBenchError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{out / 'index.html'}: {len(paths)} files, {sum(path.stat().st_size for path in paths) / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
