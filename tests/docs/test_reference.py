"""The reference that is made from the code is complete."""

from __future__ import annotations

from support import site_reference

import imumon


def test_the_library_page_has_every_public_name() -> None:
    listed = {name for names in site_reference.SECTIONS.values() for name in names}
    assert listed == set(imumon.__all__) - {"__version__"}
    page = site_reference.library()
    assert all(f"### {name}\n" in page for name in listed)
