"""Hooks of MkDocs: pages made from the code, and links to files that are not part of the site."""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))  # MkDocs takes it away again once this file is loaded

from support.site_reference import pages  # noqa: E402 - not before the path is set

OUTSIDE = re.compile(
    r"\[([^\]]+)\]\((?:\.\./)+((?:imumon|configs|tests|scripts|README|CHANGELOG|CONTRIBUTING)[^)]*)\)"
)
"""A link of a page to a file of the repository beside the docs."""

GLOSSARY = ROOT / "docs" / "glossary.md"
TERM = re.compile(r"^(.+)(?=\n: )", re.MULTILINE)
"""A term of the glossary, or several with commas between."""
LINK_OF_TERM = re.compile(r"\[([^\]]+)\]\(((?:\.\./)*glossary\.md)\)")

FIRST_USES = (
    *("AHRS", "pseudo-terminal", "segment", "digest", "soak", "specific force", "hard iron", "soft iron"),
    *("earth rate", "pose", "turn-on bias", "bias instability", "random walk", "flicker", "popcorn noise"),
    *("Gauss-Markov process", "hysteresis", "dead time", "innovation", "level bank", "BIC"),
    *("VQF", "SR-RSUKF", "ZUPT", "TCZUPT"),
)
"""Terms of the glossary that mean one thing only: a page links the first use of each."""
NO_PROSE = re.compile(
    r"(```.*?```|<!--.*?-->|`[^`\n]*`|!?\[[^\]]*\]\([^)]*\)|^#.*?$|^ {4}.*?$)", re.DOTALL | re.MULTILINE
)
"""What has no links of its own: code, comments, links, headings."""


def anchors() -> dict[str, str]:
    """Return the anchor of each term of the glossary; terms are in lower case."""
    entries = TERM.findall(GLOSSARY.read_text(encoding="utf-8"))
    return {
        name: re.sub(r"\W+", "-", entry.lower()).strip("-")
        for entry in entries
        for name in (entry.lower(), *entry.lower().split(", "))
    }


def anchor_of(text: str, known: dict[str, str]) -> str | None:
    """Return the anchor of the term that the text of a link names; None where there is none."""
    name = text.replace("*", "").lower()
    return next(
        (known[each] for each in (name, name.removesuffix("s"), name.removesuffix("es")) if each in known),
        None,
    )


def link_first_uses(markdown: str, glossary: str, known: dict[str, str]) -> str:
    """Link the first use of each of `FIRST_USES` in the prose of a page that does not link it yet."""
    parts = NO_PROSE.split(markdown)  # prose at even places
    linked = {anchor_of(link[1], known) for link in LINK_OF_TERM.finditer(markdown)}
    for term in FIRST_USES:
        anchor = anchor_of(term, known)
        spelt = re.escape(term) if term.isupper() else f"(?i:{term[0]}){re.escape(term[1:])}"
        use = re.compile(rf"(?<![\w-]){spelt}(?:e?s)?(?![\w-])")
        for at in range(0, len(parts), 2):
            match = use.search(parts[at])
            if match and anchor not in linked:
                link = f"[{match[0]}]({glossary}#{anchor})"
                parts[at : at + 1] = [parts[at][: match.start()], link, parts[at][match.end() :]]
                break
    return "".join(parts)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made from the code."""
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Name files of the repository in place of links that the site cannot follow; lead terms to entries."""
    known = anchors()

    def to_entry(link: re.Match[str]) -> str:
        anchor = anchor_of(link[1], known)
        return link[0] if anchor is None else f"[{link[1]}]({link[2]}#{anchor})"

    if page.file.src_path != GLOSSARY.name:
        markdown = link_first_uses(markdown, "../" * page.file.src_path.count("/") + GLOSSARY.name, known)
    markdown = LINK_OF_TERM.sub(to_entry, OUTSIDE.sub(lambda link: f"{link[1]} (`{link[2]}`)", markdown))
    if page.file.src_path == GLOSSARY.name:
        return TERM.sub(lambda term: f"{term[1]} {{: #{known[term[1].lower()]} }}", markdown)
    return markdown
