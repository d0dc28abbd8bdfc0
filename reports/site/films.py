"""What the site shows of candidates in motion: files that `make films` left, filmstrips in pictures of reports and of the first page."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import polars as pl

from reports.front_page import EXECUTIONS
from reports.gallery import chosen_executions
from reports.kinds import N_FILMS
from tables.vocabulary import ExecStatus, PlanStatus

FILM_KINDS = ("gif", "png", "mcap")
# What a filmstrip among others in a picture is called beside them.
_STRIP = "filmstrip"
Links = dict[str, list[tuple[str, str]]]


def film_files(folder: Path, known: Collection[str]) -> dict[str, list[str]]:
    """Kinds of files in a folder by candidate; only of candidates that are known."""
    found: dict[str, list[str]] = {}
    for kind in FILM_KINDS:
        for path in sorted(folder.glob(f"*.{kind}")):
            if path.stem in known:
                found.setdefault(path.stem, []).append(kind)
    return found


def film_links(films: Mapping[str, list[str]], candidates: pl.DataFrame, tier: str, seed: int, pictures: Iterable[str]) -> Links:
    """Where a candidate is to be seen, by its id: what to call it, and a path in the site.

    Args:
        films: kinds of files by candidate.
        candidates: of the release.
        tier: of the release.
        seed: of the hash by which the gallery chose.
        pictures: paths of the pictures in the site.
    """
    links: Links = {name: [(kind, f"films/{name}.{kind}") for kind in kinds] for name, kinds in films.items()}
    there, known = set(pictures), set(candidates["candidate_id"])
    strips = {f"reports/gallery-{status}.png": names for status, names in chosen_executions(candidates, seed, N_FILMS[tier]).items()}
    for path, names in {**strips, "pictures/executions.png": EXECUTIONS}.items():
        for name in known.intersection(names) if path in there else ():
            links.setdefault(name, []).append((_STRIP, path))
    return links


def film_entries(films: Mapping[str, list[str]], candidates: pl.DataFrame) -> list[dict[str, Any]]:
    """Films as their page lists them: by outcome, then by id."""
    labels = candidates.filter(pl.col("candidate_id").is_in(sorted(films))).select("candidate_id", "plan_status", "exec_status")
    statuses = {name: executed or planned for name, planned, executed in labels.iter_rows()}
    in_order = [status.value for status in (*ExecStatus, *PlanStatus)]
    return [
        {
            "id": name,
            "status": statuses[name].replace("_", " "),
            "picture": next((f"films/{name}.{kind}" for kind in FILM_KINDS[:2] if kind in kinds), ""),
            "files": [(kind, f"films/{name}.{kind}") for kind in kinds],
        }
        for name, kinds in sorted(films.items(), key=lambda item: (in_order.index(statuses[item[0]]), item[0]))
    ]
