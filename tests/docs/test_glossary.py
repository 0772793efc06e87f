"""A link to the glossary names a term that is in it."""

from __future__ import annotations

from support.site_hooks import FIRST_USES, GLOSSARY, LINK_OF_TERM, anchor_of, anchors, link_first_uses


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


def test_a_page_links_the_first_use_of_a_term_in_its_prose() -> None:
    known = anchors()
    assert {anchor_of(term, known) for term in FIRST_USES}.isdisjoint({None})
    page = "# A soak\n\n`soak` and [ZUPT](glossary.md): ZUPT. Soaks in two poses, soak.\n\n```sh\nsoak\n```\n"
    assert link_first_uses(page, "glossary.md", known) == page.replace(
        "Soaks in two poses", "[Soaks](glossary.md#soak) in two [poses](glossary.md#pose)"
    )
