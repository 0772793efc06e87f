"""A link to the glossary names a term that is in it."""

from __future__ import annotations

from support.site_hooks import GLOSSARY, LINK_OF_TERM, anchor_of, anchors


def test_each_link_names_a_term() -> None:
    known = anchors()
    assert known["bias"] == "bias"
    texts = [
        link[1]
        for page in GLOSSARY.parent.rglob("*.md")
        for link in LINK_OF_TERM.finditer(page.read_text(encoding="utf-8"))
    ]
    assert len(texts) > 100
    assert {text for text in texts if anchor_of(text, known) is None} <= {"glossary"}
