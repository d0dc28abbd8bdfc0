"""Markdown and templates to pages; what the pages say is decided in content.py and pages.py."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import lru_cache
from pathlib import Path
from typing import Any

import jinja2
from markdown_it import MarkdownIt
from markupsafe import Markup

ASSETS = ("style.css", "site.js")
_HERE = Path(__file__).parent
_FRONT_MATTER = re.compile(r"\A---\n.*?\n---\n", re.DOTALL)
_LINK = re.compile(r'<a href="(?![a-z]+:|#)([^"]*)">(.*?)</a>', re.DOTALL)
_IMAGE = re.compile(r'<p><img src="([^"]*)" alt="([^"]*)" ?/?></p>')


def markdown_html(text: str, files: Collection[str]) -> Markup:
    """HTML of a Markdown text: tables scroll sideways and can be sorted, pictures open alone, links to what the site lacks are plain text.

    Args:
        files: what the folder of the page holds; a picture that is not there is named instead of shown.
    """
    html = _markdown().render(_FRONT_MATTER.sub("", text, count=1))
    html = html.replace("<table>", '<div class="scroll" tabindex="0" role="region" aria-label="table"><table class="sortable">')
    html = html.replace("</table>", "</table></div>")
    html = _LINK.sub(lambda match: match[0] if match[1] in files else match[2], html)
    return Markup(_IMAGE.sub(lambda match: _figure(match[1], match[2], files), html))


def page(template: str, **values: Any) -> str:
    """A page of a template of this folder; what is not marked as HTML is escaped, a name that is not given is an error."""
    return _templates().get_template(template).render(**values)


def asset(name: str) -> str:
    """Text of the style sheet or the script."""
    return (_HERE / name).read_text(encoding="utf-8")


def _figure(source: str, text: str, files: Collection[str]) -> str:
    if source not in files:
        return f"<p>({text}: no picture was made)</p>"
    return f'<figure><a href="{source}"><img src="{source}" alt="{text}" loading="lazy"></a></figure>'


@lru_cache(maxsize=1)
def _markdown() -> MarkdownIt:
    # HTML in a text is shown, not run.
    return MarkdownIt("commonmark", {"html": False}).enable("table")


@lru_cache(maxsize=1)
def _templates() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(_HERE)
    return jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
