"""Links that the site does not follow, of the files beside the docs and out of the docs; groups of pages."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from markdown.extensions.toc import slugify

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"\]\(([^)#\s]*)#?([^)\s]*)\)")
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def text_of(page: Path) -> str:
    """Return the text of a page without blocks of code."""
    return FENCED.sub("", page.read_text(encoding="utf-8"))


def links(page: Path) -> list[tuple[Path, str]]:
    """Return file and anchor of each link of a page to another file, or to a heading."""
    found = [link for link in LINK.findall(text_of(page)) if not link[0].startswith(("http:", "https:"))]
    return [((page.parent / path).resolve() if path else page, anchor) for path, anchor in found]


def leads_nowhere(target: Path, anchor: str) -> bool:
    """Test whether there is no such file, or no such heading in it."""
    if not target.exists() or not anchor:
        return not target.exists()
    headings = re.findall(r"^#+ (.+)$", text_of(target), re.MULTILINE)
    return anchor not in {slugify(heading, "-") for heading in headings}


def test_links_of_the_files_beside_the_docs() -> None:
    pages = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    found = [(page.name, *link) for page in pages for link in links(page)]
    assert len(found) > 20
    assert [link for link in found if leads_nowhere(*link[1:])] == []


def test_links_out_of_the_docs() -> None:
    pages = (ROOT / "docs").rglob("*.md")
    found = [(page.name, *link) for page in pages for link in links(page)]
    out = [link for link in found if not link[1].is_relative_to(ROOT / "docs")]
    assert out
    assert [link for link in out if leads_nowhere(*link[1:])] == []


def test_a_link_that_leads_nowhere_is_found() -> None:
    assert leads_nowhere(ROOT / "no such file", "")
    assert leads_nowhere(ROOT / "CONTRIBUTING.md", "no-such-heading")
    assert not leads_nowhere(ROOT / "docs" / "architecture.md", "core-and-wings")


def test_the_first_page_groups_the_pages_as_the_site_does() -> None:
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    nav = yaml.safe_load(config)["nav"][1:]
    site: list[tuple[str, list[str]]] = []
    for group, pages in (one for entry in nav for one in entry.items()):
        # Pages that are made from the code are on the site alone, and the appendix has a page that lists it.
        elsewhere = [page for page in pages if re.match(r"reference/|appendix/(?!README)", page)]
        site.append((group, [page for page in pages if page not in elsewhere]))
    _, _, listed = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").partition("## All pages")
    groups = re.findall(r"^- \*\*(.*?)\*\*:(.*?)(?=^- |\Z)", listed, re.MULTILINE | re.DOTALL)
    assert [(name, [link[0] for link in LINK.findall(text)]) for name, text in groups] == site
