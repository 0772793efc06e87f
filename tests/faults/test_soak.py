"""The page that scripts/soak writes."""

from __future__ import annotations

import pytest
from support.soak import DOCS, LONG, SECTIONS


@pytest.mark.parametrize("section", SECTIONS | LONG)
def test_a_section_has_its_table_in_the_page(section: str) -> None:
    text = DOCS.read_text(encoding="utf-8")
    assert text.count(f"<!-- soak {section} -->") == text.count(f"<!-- end soak {section} -->") == 1
