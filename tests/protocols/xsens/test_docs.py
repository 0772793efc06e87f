"""The tables in the manual are those of the program."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from imumon.protocols.device import device_text, parse_device
from imumon.protocols.xsens.fields import DERIVED, IDENTIFIERS, Identifier
from imumon.protocols.xsens.mtdata import MTDataDevice, mtdata_field

PAGE = Path(__file__).resolve().parents[3] / "docs" / "devices-xsens.md"


def shorten(names: list[str]) -> str:
    """Write gyro_x, gyro_y, gyro_z as gyro_{x,y,z}."""
    found: list[tuple[str, list[str]]] = []
    for name in names:
        stem, _, last = name.rpartition("_")
        if last in tuple("wxyz"):
            if not found or found[-1][0] != stem:
                found.append((stem, []))
            found[-1][1].append(last)
        else:
            found.append((name, []))
    return ", ".join(f"`{stem}_{{{','.join(axes)}}}`" if axes else f"`{stem}`" for stem, axes in found)


SATELLITE = re.compile(r"gnss_sat\d+_")


def columns_of(item: Identifier) -> list[str]:
    names = [value.name for value in item.numbers if value.column and not SATELLITE.match(value.name)]
    for derived in DERIVED:
        if set(derived.sources) <= set(names):
            first = names.index(derived.sources[0]) if derived.sources[0] in names else 0
            names = [name for name in names if name not in derived.sources]
            names[first:first] = [column.name for column in derived.results]
    return names


def identifier_table() -> Iterator[str]:
    yield "| identifier | name | format | columns |"
    yield "|---|---|---|---|"
    for item in IDENTIFIERS:
        code = f"{item.code:04X}"
        kinds = [
            text for text, on in (("real", item.is_real), ("frame", item.framed), ("counts", item.raw)) if on
        ]
        row = f"| {code} | {item.name} | {', '.join(kinds)} | {shorten(columns_of(item))} |"
        yield row


def test_the_table_of_identifiers_is_that_of_the_program() -> None:
    text = PAGE.read_text(encoding="utf-8")
    expected = "\n".join(dict.fromkeys(identifier_table()))
    shown = text[text.index("| identifier |") :].split("\n\n", 1)[0]
    assert shown == expected


def test_the_example_profile_is_a_device_file_of_the_stated_length() -> None:
    text = PAGE.read_text(encoding="utf-8")
    example = text.split("```yaml\n")[1].split("```")[0]
    device = parse_device(example, "example.yaml")
    assert isinstance(device, MTDataDevice)
    assert f"{mtdata_field(device).size} bytes" in text


@pytest.mark.parametrize("name", ["xsens", "xsens-legacy"])
def test_the_device_files_are_named(name: str) -> None:
    assert device_text(name)[0]
    assert f"--device {name}" in PAGE.read_text(encoding="utf-8")
