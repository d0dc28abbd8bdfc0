"""The site in a real browser: it opens from a folder without errors, fetches nothing, its links resolve, filters filter and tables sort."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pytest

from reports.kinds import KINDS, N_FILMS
from reports.load import Task
from reports.paper import RANKING
from reports.site.__main__ import main
from reports.site.content import MAX_CANDIDATES, browsed, browser_data
from reports.site.films import film_links
from reports.site.pages import Site
from reports.site.rendering import markdown_html
from reports.sources import Sources
from splits.provenance import own_provenance
from splits.release import write_release
from splits.release_reader import Release
from tables.vocabulary import Allocation
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE


class _Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value for name, value in attrs if name in ("href", "src") and value]


@pytest.fixture(scope="module")
def release(release_tables: dict[str, pa.Table], tmp_path_factory: pytest.TempPathFactory) -> Release:
    directory = tmp_path_factory.mktemp("release")
    write_release(release_tables, directory / "full", "full", "0.1.0", PROVENANCE, TOLERANCES)
    return Release.open(directory / "full")


@pytest.fixture(scope="module")
def site(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site with one report and films of two candidates; a file of an unknown candidate lies among them."""
    reports, out = tmp_path_factory.mktemp("reports"), tmp_path_factory.mktemp("site")
    KINDS["success_at_k"].make(Sources(release, reports / "nothing")).write(reports)
    (reports / "films").mkdir()
    for name in (*release.candidates["candidate_id"][:2], "full-9999-t0-g00"):
        (reports / "films" / f"{name}.mcap").write_bytes(b"a trace")
    assert main([str(release.directory), "--reports", str(reports), "--out", str(out)]) == 0
    return out


def test_every_link_resolves_and_nothing_is_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert {page.relative_to(site).as_posix() for page in pages} >= {
        "index.html",
        "candidates.html",
        "card.html",
        "reports/success_at_k.html",
    }
    for page in pages:
        links = _Links()
        links.feed(page.read_text(encoding="utf-8"))
        for link in links.found:
            if link.startswith("data:,"):
                continue
            path, _, anchor = link.partition("#")
            assert not re.match(r"[a-z]+:|//", path), f"{page.name}: {link} is from elsewhere"
            assert not path or (page.parent / path).is_file(), f"{page.name}: {link} leads nowhere"
            if anchor and not path:
                assert f'id="{anchor}"' in page.read_text(encoding="utf-8")
    assert "@import" not in (site / "style.css").read_text()
    assert "url(" not in (site / "style.css").read_text()


def test_the_ladder_shows_the_numbers_of_the_report(site: Path, release: Release) -> None:
    report = KINDS["success_at_k"].make(Sources(release, site / "nothing"))
    low, value, high = (100 * report.metrics[f"test.joint.ik_only.s1{end}"] for end in ("_low", "", "_high"))
    index = (site / "index.html").read_text(encoding="utf-8")
    theirs = RANKING[Task.JOINT, "ik_only"].s1
    assert re.search(rf"{value:.1f} <small>\[{low:.1f}, {high:.1f}\]</small></td>\s*<td class=\"number\">{theirs:.2f}</td>", index)
    assert "The oracle knows every label" in index
    assert "is its network" not in index, "of a policy that no row is of"
    assert "No ranker was scored" in index


def test_a_site_of_one_s_own_claims_nothing_of_the_benchmark(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    """Neither its name, licence, pictures and figures nor its objects: every command names the catalogue."""
    provenance = {**PROVENANCE, **own_provenance("my_objects.toml", "my_recipe.toml", Allocation.APPENDED)}
    write_release(release_tables, tmp_path / "full", "full", "0.1.0", provenance, TOLERANCES)
    own, reports = Release.open(tmp_path / "full"), tmp_path / "reports"
    KINDS["success_at_k"].make(Sources(own, reports)).write(reports)
    files = {name: content.decode() for name, content in Site(own, reports, reports / "films").files().items() if not name.endswith(".png")}
    pages = {name: text for name, text in files.items() if name.endswith(".html")}
    for name, text in pages.items():
        assert text.count("This is not the PlaceBench benchmark") == 1, name
        assert "CC-BY" not in text, name
        assert "to be stated by whoever publishes it" in text, name
    assert "open benchmark" not in pages["index.html"]
    assert "paper S1" not in pages["index.html"]
    assert not [name for name in pages if "pictures/" in pages[name]]
    shown = [files[name] for name in ("candidates.js", "index.html", "films.html")]
    named = "--data data/own/my_objects --catalogue my_objects.toml"
    assert [(text.count("pipelines.regenerate"), text.count(named)) for text in shown] == [(1, 1)] * 3


def test_a_sample_is_by_hash_and_keeps_what_was_filmed(release: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    assert release.candidates.height <= MAX_CANDIDATES
    monkeypatch.setattr("reports.site.content.MAX_CANDIDATES", 50)
    last = release.candidates["candidate_id"][-1]
    sample = browsed(release, 42, frozenset([last]))
    assert sample.height == 50
    assert last in set(sample["candidate_id"])
    assert set(browsed(release, 43, frozenset())["candidate_id"]) != set(browsed(release, 42, frozenset())["candidate_id"])


def test_what_the_gallery_shows_is_linked(release: Release) -> None:
    """Of a status whose picture is in the site, as many candidates as the gallery shows, and no others."""
    status = release.candidates["exec_status"].drop_nulls()[0]
    path = f"reports/gallery-{status}.png"
    links = film_links({"full-0000-t0-g00": ["gif"]}, release.candidates, "full", 42, [path, "reports/gallery-title.png"])
    assert links.pop("full-0000-t0-g00")[0] == ("gif", "films/full-0000-t0-g00.gif")
    ended_so = release.candidates.filter(release.candidates["exec_status"] == status)["candidate_id"]
    assert 0 < len(links) <= N_FILMS["full"]
    assert set(links) <= set(ended_so)
    assert all(there == [("filmstrip", path)] for there in links.values())
    assert set(browsed(release, 42, frozenset(links))["candidate_id"]) >= set(links)


def test_browser_data_decodes_to_the_labels(release: Release) -> None:
    frame = browsed(release, 42, frozenset())
    data = browser_data(frame, {}, "make ID")
    statuses = [None if k is None else data["words"]["exec_status"][k] for k in data["columns"]["exec_status"]]
    assert statuses == frame["exec_status"].to_list()


def test_markdown_cannot_bring_html_or_dead_links() -> None:
    html = markdown_html("---\na: b\n---\n# T <b>\n\n<script>x</script>\n\n[there](a.html) [gone](b.html)\n\n![p](no.png)\n", ("a.html",))
    assert "<script>" not in html
    assert "a: b" not in html
    assert '<a href="a.html">there</a> gone' in html
    assert "no picture was made" in html


def test_a_folder_of_something_else_is_not_taken(release: Release, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert main([str(release.directory), "--reports", str(tmp_path / "none"), "--out", str(tmp_path)]) == 1
    assert "must be empty or a site" in capsys.readouterr().err
    assert (tmp_path / "mine.txt").exists()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium as the system has it."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    binary, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if binary is None or driver is None:
        pytest.skip("no chromium with chromedriver on the path: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"):
        options.add_argument(argument)
    window = webdriver.Chrome(options, webdriver.ChromeService(driver))
    window.set_page_load_timeout(120)
    yield window
    window.quit()


def _found(browser: Any) -> int:
    return int(browser.find_element("id", "found").text.split()[0].replace(",", ""))


def test_no_page_has_an_error_or_a_sideways_scroll_on_a_phone(site: Path, browser: Any) -> None:
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True})
    for page in sorted(site.rglob("*.html")):
        browser.get(page.as_uri())
        assert browser.get_log("browser") == []
        width = browser.execute_script("return document.documentElement.scrollWidth")
        assert width <= 390, f"{page.name} is {width} px wide on a phone of 390"
        broken = "return [...document.images].filter(i => i.loading !== 'lazy' && i.complete && !i.naturalWidth).length"
        assert browser.execute_script(broken) == 0
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_dark_is_dark(site: Path, browser: Any) -> None:
    colours = []
    for scheme in ("light", "dark"):
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]})
        browser.get((site / "index.html").as_uri())
        colours.append(browser.execute_script("return getComputedStyle(document.body).backgroundColor"))
    assert colours == ["rgb(255, 255, 255)", "rgb(20, 24, 28)"]


def test_the_filter_filters(site: Path, browser: Any, release: Release) -> None:
    select = pytest.importorskip("selenium.webdriver.support.select")
    frame = release.candidates
    browser.get((site / "candidates.html").as_uri())
    assert _found(browser) == frame.height
    status = frame["exec_status"].drop_nulls()[0]
    choose = (
        "const field = document.querySelector(`[name=${arguments[0]}]`);"
        "field.value = arguments[1]; field.dispatchEvent(new Event('input', {bubbles: true}))"
    )
    browser.execute_script(choose, "exec_status", status)
    assert _found(browser) == (frame["exec_status"] == status).sum()
    browser.execute_script(choose, "n_obstacles", "1")
    assert _found(browser) == ((frame["exec_status"] == status) & (frame["n_obstacles"] == 1)).sum()
    cells = browser.execute_script("return [...document.querySelectorAll('#browser tbody tr')].map(r => r.cells[5].textContent)")
    assert set(cells) <= {status}
    browser.find_element("css selector", "#filters button").click()
    # As other programs choose, which tell of a change alone, and as people do.
    browser.execute_script(choose.replace("'input'", "'change'"), "exec_status", status)
    assert _found(browser) == (frame["exec_status"] == status).sum()
    select.Select(browser.find_element("name", "n_obstacles")).select_by_visible_text("1")
    assert _found(browser) == ((frame["exec_status"] == status) & (frame["n_obstacles"] == 1)).sum()
    browser.find_element("css selector", "#filters button").click()
    browser.find_element("name", "film").click()
    assert _found(browser) == 2
    links = browser.execute_script("return [...document.querySelectorAll('#browser tbody a')].map(a => a.getAttribute('href'))")
    assert len(links) == 2
    assert all((site / link).is_file() for link in links)
    assert browser.get_log("browser") == []


def test_scenes_are_filtered_and_come_by_pages(site: Path, browser: Any, release: Release) -> None:
    select = pytest.importorskip("selenium.webdriver.support.select")
    scenes = pl.DataFrame(release.table("scenes"))
    browser.get((site / "scenes.html").as_uri())
    rows = "return [...document.querySelectorAll('#rows tbody tr')].filter(r => !r.hidden).map(r => r.cells[arguments[0]].textContent)"
    assert _found(browser) == scenes.height
    assert len(browser.execute_script(rows, 0)) == min(100, scenes.height)
    object_id = str(scenes["object_id"][-1])
    select.Select(browser.find_element("name", "1")).select_by_visible_text(object_id)
    assert _found(browser) == (scenes["object_id"].cast(pl.String) == object_id).sum()
    assert set(browser.execute_script(rows, 1)) == {object_id}
    browser.find_elements("css selector", "th button")[4].click()
    assert set(browser.execute_script(rows, 1)) == {object_id}, "sorting keeps the filter"
    browser.find_element("css selector", ".filters button").click()
    browser.find_element("name", "0").send_keys("full-0001")
    assert browser.execute_script(rows, 0) == ["full-0001"]
    assert browser.get_log("browser") == []


def test_a_table_wider_than_its_box_says_so(site: Path, browser: Any) -> None:
    # Sizes are told after the page was laid out.
    says = """const tell = arguments[0], box = document.querySelector('.scroll');
              requestAnimationFrame(() => setTimeout(() => tell(box.classList.contains('overflows')), 50))"""
    said = []
    for width in (390, 1600):
        size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get((site / "objects.html").as_uri())
        said.append(browser.execute_async_script(says))
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert said == [True, False]


def test_tables_sort_by_keyboard_and_an_id_gives_its_command(site: Path, browser: Any) -> None:
    browser.get((site / "scenes.html").as_uri())
    button = browser.find_elements("css selector", "th button")[4]
    column = "return [...document.querySelectorAll('tbody tr')].map(r => parseInt(r.cells[4].textContent))"
    for order in (1, -1):
        button.send_keys("\ue007")  # Enter
        values = browser.execute_script(column)
        assert values == sorted(values)[::order]
    browser.get((site / "candidates.html").as_uri())
    first = browser.find_element("css selector", "#browser button.id")
    first.send_keys("\ue007")
    shown = browser.find_element("id", "command").text
    assert shown.startswith(f"python -m pipelines.regenerate {first.text} --release data/release/full --mcap")
