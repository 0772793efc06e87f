"""The reference that is made from the code is complete."""

from __future__ import annotations

import re

import pytest
from support import site_reference

import imumon


def test_the_library_page_has_every_public_name() -> None:
    listed = {name for names in site_reference.SECTIONS.values() for name in names}
    assert listed == set(imumon.__all__) - {"__version__"}
    page = site_reference.library()
    assert all(f"### {name}\n" in page for name in listed)


def rows(page: str) -> list[list[str]]:
    """Return the cells of the rows of a page's tables of keys: key, type, unit, default, meaning."""
    found = re.findall(r"^\| (`.*) \|$", page, re.MULTILINE)
    return [re.split(r"(?<!\\) \| ", row) for row in found]


def test_no_setting_is_without_meaning_or_link() -> None:
    keys = rows(site_reference.settings())
    assert len(keys) > 300
    assert [row for row in keys if len(row) != 5 or not row[4].strip()] == []


def test_settings_have_the_tables_of_every_file() -> None:
    page = site_reference.settings()
    titles = re.findall(r"^###? (.*?)(?: \{.*)?$", page, re.MULTILINE)
    assert {"`time`", "Unit file", "Rack of units", "`units`", "`gyro_turn_on`"} <= set(titles)
    files = re.split(r"^## ", page, flags=re.MULTILINE)
    within = [re.findall(r"^### (.*?) \{", one, re.MULTILINE) for one in files]
    assert all(len(set(titles)) == len(titles) for titles in within)
    assert "|---|---|---|---|---|\n\n" not in page  # an empty table
    assert "\t" not in page
    assert r"`'\t'` or `' '`" in page


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("rate_hz", "Hz"),
        ("hold_s", "s"),
        ("amplitude_sd_ug", "µg"),
        ("gyro_bias_sd_deg_per_h", "°/h"),
        ("angle_random_walk_rad_per_sqrt_s", "rad/√s"),
        ("rate_random_walk_rad_per_s_sqrt_s", "rad/s/√s"),
        ("rate_degc_per_min", "°C/min"),
        ("gravity_m_per_s2", "m/s²"),
        ("false_alarm_hours", "h"),
        ("bytesize", ""),
    ],
)
def test_a_unit_is_that_of_the_name(key: str, unit: str) -> None:
    cells = next(row for row in rows(site_reference.settings()) if row[0] == f"`{key}`")
    assert cells[2].strip() == unit


def test_a_meaning_is_that_of_the_page() -> None:
    meanings = {row[0]: row[4] for row in rows(site_reference.settings())}
    assert meanings["`tail`"].startswith("optional: bytes such as")  # a row of its own
    assert "leaves 0" in meanings["`modulo`"]  # named in the row of `when`
    assert "(../appendix/allan-details.md#terms)" in meanings["`quantization_rad`"]  # a link alone


def test_signatures_have_plain_types() -> None:
    page = site_reference.library()
    assert "begin_s: float | None" in " ".join(page.split())
    assert not re.search(r"Annotated|FieldInfo|Optional|typing|NoneType|numpy\.|\bself\b(?=[,)])", page)
    assert "Samples.to_numpy(*names: str) -> ndarray" in page
