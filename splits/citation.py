"""How a release is cited, read from CITATION.cff at the top of the repository: whatever a release says of title, authors, date or DOI."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from splits.errors import ReleaseError, shown
from splits.fields import check_version
from splits.provenance import PACKAGE_ROOT

CITATION_FILE = PACKAGE_ROOT / "CITATION.cff"

_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_DOI = re.compile(r"10\.\d{4,9}/\S+")


@dataclass(frozen=True, slots=True)
class Work:
    """A title and who wrote it, `Given Family` or the name of a group."""

    title: str
    authors: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.title or not self.authors:
            raise ReleaseError(f"title {shown(self.title)} and authors {shown(list(self.authors))}, must both be given")


@dataclass(frozen=True, slots=True)
class Citation:
    """The data as a work.

    Attributes:
        version: of the data that the code makes, and that was released on `date`.
        date: of that version, `year-month-day`.
        doi: None as long as the data are not deposited anywhere.
        key: of the BibTeX entry.
        has_date: whether `date` is that of the data.
        protocol: the paper whose protocol the data follow.
    """

    work: Work
    abstract: str
    version: str
    date: str
    doi: str | None
    keywords: tuple[str, ...]
    protocol: Work
    key: str = "placebench"
    has_date: bool = True

    def __post_init__(self) -> None:
        check_version("version", self.version)
        if not _DATE.fullmatch(self.date):
            raise ReleaseError(f"date-released {shown(self.date)}, must be year-month-day")
        if self.doi is not None and not _DOI.fullmatch(self.doi):
            raise ReleaseError(f"doi {shown(self.doi)}, must be 10.<registrant>/<name> without https://doi.org/")

    @property
    def url(self) -> str | None:
        """Where the data are found for good; None without a DOI."""
        return None if self.doi is None else f"https://doi.org/{self.doi}"

    def date_of(self, version: str) -> str | None:
        """When a version of the data was released; None where that is not known: the file knows the date of one version."""
        return self.date if self.has_date and version == self.version else None

    def bibtex(self, tier: str, version: str) -> str:
        """BibTeX of a release; the year is that of its version, left out where it is not known."""
        date = self.date_of(version)
        lines = [
            f"  title   = {{{{{self.work.title} ({tier})}}}}",
            f"  author  = {{{' and '.join(f'{{{name}}}' for name in self.work.authors)}}}",
            *([f"  year    = {{{date[:4]}}}"] if date else []),
            f"  version = {{{version}}}",
            *([f"  doi     = {{{self.doi}}}"] if self.doi else []),
        ]
        return f"@misc{{{self.key},\n" + ",\n".join(lines) + "\n}"


def load_citation(path: Path = CITATION_FILE) -> Citation:
    """The citation in a CFF file; raises ReleaseError where it cannot be read, lacks a field or holds an impossible one."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        return Citation(
            work=_work(content),
            abstract=content["abstract"],
            version=content["version"],
            date=str(content["date-released"]),
            doi=content.get("doi"),
            keywords=tuple(content["keywords"]),
            protocol=_work(content["references"][0]),
        )
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise ReleaseError(f"{path}: cannot be read as a citation: {' '.join(str(error).split())}") from error


def _work(content: Mapping[str, Any]) -> Work:
    authors = [author.get("name") or f"{author['given-names']} {author['family-names']}" for author in content["authors"]]
    return Work(content["title"], tuple(authors))
