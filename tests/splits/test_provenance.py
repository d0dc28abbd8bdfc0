"""The commit of a checkout, in repositories of their own; what a release must state."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from splits.errors import ReleaseError
from splits.provenance import LIBRARIES, PACKAGE_ROOT, check_provenance, git_commit
from tables.versions import library_versions
from tests.splits.damage import PROVENANCE


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.org", "-c", "commit.gpgsign=false"]
    done = subprocess.run(["git", "-C", str(folder), *who, *arguments], check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture(autouse=True)
def no_other_repository(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither the variables of a hook that runs the tests nor a repository above the temporary folder counts."""
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with one commit of a module in a package."""
    folder = tmp_path / "checkout"
    (folder / "package").mkdir(parents=True)
    (folder / "package" / "module.py").write_text("X = 1\n")
    (folder / ".gitignore").write_text("data/\n")
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "--message", "first")
    return folder


def test_a_clean_checkout_is_its_commit(checkout: Path) -> None:
    (checkout / "data").mkdir()
    (checkout / "data" / "table.parquet").write_text("ignored")
    assert git_commit(checkout) == git(checkout, "rev-parse", "HEAD")
    assert git_commit(checkout / "package") == git_commit(checkout)
    assert len(git_commit(checkout)) == 40


@pytest.mark.parametrize("change", ["edit", "stage", "delete", "add"])
def test_a_checkout_that_differs_is_dirty(checkout: Path, change: str) -> None:
    module = checkout / "package" / "module.py"
    if change == "delete":
        module.unlink()
    elif change == "add":
        module.with_name("more.py").write_text("Y = 2\n")
    else:
        module.write_text("X = 2\n")
    if change == "stage":
        git(checkout, "add", ".")
    assert git_commit(checkout) == f"{git(checkout, 'rev-parse', 'HEAD')}-dirty"


def test_tables_that_the_checkout_holds_are_no_difference(checkout: Path) -> None:
    (checkout / ".gitignore").write_text("")
    git(checkout, "commit", "--quiet", "--all", "--message", "nothing is ignored")
    table = checkout / "data" / "release" / "full" / "t.parquet"
    table.parent.mkdir(parents=True)
    table.write_text("new")
    assert git_commit(checkout) == git(checkout, "rev-parse", "HEAD")
    (checkout / "package" / "data").mkdir()
    (checkout / "package" / "data" / "module.py").write_text("X = 2\n")
    assert git_commit(checkout).endswith("-dirty"), "only the folder at the top"


def test_a_hook_of_another_repository_does_not_count(checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "other"
    other.mkdir()
    git(other, "init", "--quiet")
    expected = git_commit(checkout)
    monkeypatch.setenv("GIT_DIR", str(other / ".git"))
    monkeypatch.setenv("GIT_WORK_TREE", str(other))
    assert git_commit(checkout) == expected != "unknown"


def test_outside_a_checkout_the_commit_is_unknown(checkout: Path, tmp_path: Path) -> None:
    assert git_commit(tmp_path) == "unknown"
    assert git_commit(tmp_path / "gone") == "unknown"
    empty = tmp_path / "empty"
    empty.mkdir()
    git(empty, "init", "--quiet")
    (empty / "module.py").write_text("X = 1\n")
    git(empty, "add", ".")
    assert git_commit(empty) == "unknown", "no commit yet"


def test_an_installed_package_does_not_take_the_commit_of_the_repository_around_it(checkout: Path) -> None:
    installed = checkout / "data" / "site-packages"
    installed.mkdir(parents=True)
    (installed / "module.py").write_text("X = 1\n")
    assert git_commit(installed) == "unknown"


def test_without_git_the_commit_is_unknown(checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert git_commit(checkout) == "unknown"


def test_the_commit_of_this_package_may_be_released() -> None:
    assert (PACKAGE_ROOT / "splits" / "provenance.py").exists()
    check_provenance({**PROVENANCE, "git_commit": git_commit()})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("git_commit", "a1" * 19),
        ("git_commit", "A1" * 20),
        ("git_commit", "a1" * 20 + "-"),
        ("git_commit", "a1" * 20 + "\n"),
        ("git_commit", "unknown-dirty"),
        ("git_commit", ""),
        ("recipe_hash", "0" * 63),
        ("catalogue_hash", "none"),
    ],
)
def test_a_malformed_fact_is_refused(name: str, value: str) -> None:
    with pytest.raises(ReleaseError, match=f"provenance: {name} .*must be"):
        check_provenance({**PROVENANCE, name: value})


@pytest.mark.parametrize("name", ["recipe_hash", "catalogue_hash", "git_commit"])
def test_a_missing_fact_is_refused(name: str) -> None:
    with pytest.raises(ReleaseError, match=f"provenance: {name} is missing"):
        check_provenance({key: value for key, value in PROVENANCE.items() if key != name})


@pytest.mark.parametrize("commit", ["a1" * 20, "a1" * 20 + "-dirty", "unknown"])
def test_what_git_commit_answers_may_be_released(commit: str) -> None:
    check_provenance({**PROVENANCE, "git_commit": commit})


def test_libraries_are_named_with_their_versions() -> None:
    versions = library_versions(LIBRARIES)
    assert versions["python"].startswith("3.")
    assert all(version and version != "not installed" for version in versions.values())
