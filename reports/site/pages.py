"""The site of a release as files by path; `python -m reports.site` writes them."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from reports.front_page import FRONT_PICTURES, FRONT_TIER, PICTURES
from reports.kinds import KINDS
from reports.paper import RANKING_SOURCE
from reports.ranking import KS, TASK_TITLE
from reports.site.content import browsed, browser_data, ladder, objects, policies_explained, scenes
from reports.site.films import film_entries, film_files, film_links
from reports.site.rendering import ASSETS, asset, markdown_html, page
from splits.commands import ANY_ID, make_command, regenerate_command, what_to_put_in
from splits.manifest import CARD, DATASHEET
from splits.markdown import MISSING
from splits.own import LICENCE_OF_OWN, name_of, notice_of
from splits.provenance import is_own
from splits.release_reader import Release
from tables.schemas import HEAVY_TABLES
from tables.vocabulary import ExecStatus, Split

_FILM_FLAGS = "--mcap out.mcap --filmstrip out.png --gif out.gif"
_MENU = (
    ("Results", "index.html"),
    ("Objects", "objects.html"),
    ("Scenes", "scenes.html"),
    ("Films", "films.html"),
    ("Candidates", "candidates.html"),
    ("Data card", "card.html"),
    ("Datasheet", "datasheet.html"),
)
_OF_RELEASE = ("card.html", "datasheet.html")
_FILTERS = (
    ("object_id", "object"),
    ("n_obstacles", "obstacles"),
    ("resting", "target rests"),
    ("plan_status", "plan"),
    ("exec_status", "execution"),
    ("split", "split"),
)
# Those that a phone leaves out; filters have them.
_MINOR = ("object_id", "n_obstacles", "resting", "error_mm", "split")
_COLUMNS = (
    ("candidate_id", "candidate"),
    ("object_id", "object"),
    ("n_obstacles", "obstacles"),
    ("resting", "target rests"),
    ("plan_status", "plan"),
    ("exec_status", "execution"),
    ("error_mm", "off by [mm]"),
    ("split", "split"),
    ("film", "film"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """What a site is made of.

    Attributes:
        reports: folder of rendered reports; those that are not there are named as missing.
        films: folder of `<candidate id>.gif`, `.png` and `.mcap`; may be empty or not there.
    """

    release: Release
    reports: Path
    films: Path

    def files(self) -> dict[str, bytes]:
        """Every file of the site by its path in it."""
        films, texts = film_files(self.films, set(self.release.candidates["candidate_id"])), self._reports()
        files = {name: asset(name).encode() for name in ASSETS}
        pictures = {path.name: path.read_bytes() for name in texts for path in sorted(self.reports.glob(f"{name}*.png")) if path.is_file()}
        files |= {f"reports/{name}": content for name, content in pictures.items()}
        front = self._front()
        files |= front
        files |= {f"films/{name}.{kind}": (self.films / f"{name}.{kind}").read_bytes() for name, kinds in films.items() for kind in kinds}
        seed = int(self.release.manifest.provenance.get("recipe_seed", "42"))
        links = film_links(films, self.release.candidates, self.release.manifest.tier, seed, files)
        frame = browsed(self.release, seed, frozenset(links))
        data = json.dumps(browser_data(frame, links, self._command(ANY_ID)), separators=(",", ":"), sort_keys=True)
        files["candidates.js"] = f"window.CANDIDATES={data};\n".encode()
        pages = {
            "index.html": self._index(texts, set(pictures), frame, front),
            "objects.html": self._objects(set(pictures)),
            "scenes.html": self._scenes(set(pictures)),
            "films.html": self._film_page(films, set(pictures), front),
            "candidates.html": self._candidates(frame, len(links)),
            "card.html": self._text("Data card", "card.html", (self.release.directory / CARD).read_text(encoding="utf-8")),
            "datasheet.html": self._text("Datasheet", "datasheet.html", (self.release.directory / DATASHEET).read_text(encoding="utf-8")),
            **{f"reports/{name}.html": self._report(name, text, set(pictures)) for name, text in texts.items()},
        }
        return files | {name: text.encode() for name, text in pages.items()}

    def _page(self, template: str, title: str, here: str, **values: Any) -> str:
        manifest = self.release.manifest
        own = is_own(manifest.provenance)
        site = {
            "name": name_of(manifest.provenance),
            "tier": manifest.tier,
            "version": "" if own else manifest.version,
            "release_hash": manifest.release_hash,
            "menu": _MENU,
            "own": own,
            "notice": markdown_html("\n".join(notice_of(manifest.provenance)), ()),
            "licence": LICENCE_OF_OWN if own else manifest.licence,
            "put_in": what_to_put_in(manifest.provenance, manifest.tier),
        }
        # Card and datasheet bring the notice themselves.
        values = {"says_notice": here in _OF_RELEASE, **values}
        return page(template, title=title, here=here, root="../" * here.count("/"), site=site, **values)

    def _reports(self) -> dict[str, str]:
        paths = {name: self.reports / f"{name}.md" for name in ("success_at_k", *(name for name in KINDS if name != "success_at_k"))}
        return {name: path.read_text(encoding="utf-8") for name, path in paths.items() if path.exists()}

    def _front(self) -> dict[str, bytes]:
        """The pictures of the README, on the site of the release that they are of."""
        if self.release.manifest.tier != FRONT_TIER or is_own(self.release.manifest.provenance):
            return {}
        return {f"pictures/{name}.png": (PICTURES / f"{name}.png").read_bytes() for name in FRONT_PICTURES}

    def _index(self, texts: Mapping[str, str], pictures: set[str], frame: pl.DataFrame, front: Collection[str]) -> str:
        metrics = self._metrics()
        split = Split.TEST.value if any(name.startswith(f"{Split.TEST.value}.") for name in metrics) else "all"
        ladders = {f"{title.lower()}, {split}": ladder(metrics, split, task) for task, title in TASK_TITLE.items()}
        # The paper reports its test split.
        paper_source = RANKING_SOURCE if split == Split.TEST.value and not is_own(self.release.manifest.provenance) else ""
        tables = self.release.manifest.tables
        candidates = self.release.candidates
        facts = [
            (f"{tables['objects'].rows:,}", "objects"),
            (f"{tables['scenes'].rows:,}", "scenes"),
            (f"{candidates.height:,}", "candidates"),
            (f"{100 * float(candidates['y_plan'].sum()) / max(1, candidates.height):.1f} %", "planned"),
            (f"{100 * float(candidates['y_pipe'].fill_null(False).sum()) / max(1, candidates.height):.1f} %", "successes"),
        ]
        successes = frame.filter(pl.col("exec_status") == ExecStatus.SUCCESS.value)["candidate_id"]
        example = str((successes if len(successes) else frame["candidate_id"])[0])
        return self._page(
            "index.html",
            "Results",
            "index.html",
            facts=facts,
            panels=[{"title": title, "rungs": rungs} for title, rungs in ladders.items() if rungs],
            paper=paper_source,
            explained=policies_explained({rung.label for rungs in ladders.values() for rung in rungs}),
            ks=KS,
            has_ranker=any(".ranker." in name for name in metrics),
            pictures=pictures,
            front=front,
            reports=[(_title(text, name), f"reports/{name}.html") for name, text in texts.items()],
            missing=[name.replace("_", " ") for name in KINDS if name not in texts],
            command=self._command(example),
        )

    def _metrics(self) -> dict[str, float]:
        path = self.reports / "success_at_k.json"
        metrics: dict[str, float] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        return metrics

    def _report(self, name: str, text: str, pictures: set[str]) -> str:
        return self._page("text.html", _title(text, name), f"reports/{name}.html", html=markdown_html(text, pictures))

    def _text(self, title: str, here: str, text: str) -> str:
        return self._page("text.html", title, here, html=markdown_html(text, ()))

    def _objects(self, pictures: set[str]) -> str:
        numbers = ("size x [mm]", "y", "z", "mass [g]", "friction", "parts", "resting poses", "pool grasps", "candidates", "success [%]")
        rows = [
            [
                row["object_id"],
                row["category"],
                row["name"],
                *(f"{1e3 * row[f'size_{axis}_m']:.0f}" for axis in "xyz"),
                f"{1e3 * row['mass_kg']:.0f}",
                f"{row['friction']:.2f}",
                *(MISSING if row[name] is None else row[name] for name in ("object_parts", "stable_poses", "grasp_pool")),
                *_rate(row),
            ]
            for row in objects(self.release).iter_rows(named=True)
        ]
        return self._table(
            "Objects",
            "objects.html",
            "What is manipulated: the convex parts that planner and physics are given, and the pool of grasps, a colour for each kind.",
            [("object", False), ("category", False), ("name", False), *((name, True) for name in numbers)],
            rows,
            [
                ("reports/gallery-objects.png", "Convex parts and grasp pools"),
                ("reports/gallery-grasps.png", "Grasps that passed the lift"),
            ],
            pictures,
        )

    def _scenes(self, pictures: set[str]) -> str:
        rows = [
            [row["scene_id"], row["object_id"], row["n_obstacles"], row["split"], *_rate(row)]
            for row in scenes(self.release).iter_rows(named=True)
        ]
        return self._table(
            "Scenes",
            "scenes.html",
            "One scene is an object, 0 to 2 box obstacles and 8 placement targets.",
            [("scene", False), ("object", False), ("obstacles", True), ("split", False), ("candidates", True), ("success [%]", True)],
            rows,
            [("reports/gallery-scenes.png", "Object blue, obstacles brown, targets green")],
            pictures,
            filtered=(1, 2, 3),
        )

    def _table(
        self,
        title: str,
        here: str,
        about: str,
        columns: list[tuple[str, bool]],
        rows: list[list[Any]],
        shown: list[tuple[str, str]],
        pictures: set[str],
        filtered: Collection[int] = (),
    ) -> str:
        """A page of one table; columns that are filtered make it one of pages of rows."""
        filters = [(k, columns[k][0], [str(value) for value in sorted({row[k] for row in rows})]) for k in filtered]
        there = [(source, text) for source, text in shown if source.removeprefix("reports/") in pictures]
        return self._page("table.html", title, here, about=about, columns=columns, rows=rows, pictures=there, filters=filters)

    def _film_page(self, films: Mapping[str, list[str]], pictures: set[str], front: Collection[str]) -> str:
        listed = film_entries(films, self.release.candidates)
        strips = [
            (f"reports/gallery-{status.value}.png", status.value.replace("_", " ").capitalize())
            for status in ExecStatus
            if f"gallery-{status.value}.png" in pictures
        ]
        return self._page("films.html", "Films", "films.html", films=listed, strips=strips, front=front, **self._film_commands())

    def _command(self, name: str) -> str:
        """What makes a candidate again, as files to look at."""
        return regenerate_command(name, self.release.manifest.provenance, self.release.manifest.tier, _FILM_FLAGS)

    def _film_commands(self) -> dict[str, str]:
        """What makes a film of any candidate, and those that the page would show."""
        lacking = [target for name in self.release.left_out if name in ("plans", "scene_points") and (target := HEAVY_TABLES[name])]
        manifest = self.release.manifest
        return {"command": self._command(ANY_ID), "make_films": make_command([*lacking, "films"], manifest.provenance, manifest.tier)}

    def _candidates(self, frame: pl.DataFrame, n_filmed: int) -> str:
        values = {name: [str(value) for value in sorted(frame[name].drop_nulls().unique().to_list())] for name, _ in _FILTERS}
        return self._page(
            "candidates.html",
            "Candidates",
            "candidates.html",
            n_shown=frame.height,
            n_filmed=n_filmed,
            n_all=self.release.manifest.tables["candidates"].rows,
            filters=[(name, label, values[name]) for name, label in _FILTERS],
            columns=[(name, label, name in _MINOR) for name, label in _COLUMNS],
        )


def _rate(row: Mapping[str, Any]) -> list[str]:
    if not row["candidates"]:
        return ["0", MISSING]
    return [f"{row['candidates']:,}", f"{100 * row['successes'] / row['candidates']:.1f}"]


def _title(text: str, name: str) -> str:
    heading = next((line for line in text.splitlines() if line.startswith("# ")), name)
    return heading.removeprefix("# ").replace("`", "")
