"""Hooks of MkDocs: pages made from the code, and links to files that are not part of the site."""

from __future__ import annotations

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


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made from the code."""
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Name files of the repository in place of a link that the site cannot follow."""
    return OUTSIDE.sub(lambda link: f"{link[1]} (`{link[2]}`)", markdown)
