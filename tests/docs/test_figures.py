"""Each figure of the docs has a comment under it with the command that draws it, and is used."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pictures import PICTURES as DRAWN
from support.screenshots import CROPS, SHOWN
from support.tutorials import ROOT

DOCS = ROOT / "docs"
FLEET = "PYTHONPATH=.:scripts:scripts/reproduce python -m support.fleet_pictures"
TUTORIALS = "PYTHONPATH=scripts python -m support.tutorials"
COMMANDS = {f"figures/{name}.png": f"scripts/reproduce/pictures --only {name}" for name in DRAWN}
COMMANDS |= {
    f"images/{picture}.png": f"scripts/screenshots {scene}"
    for name, (scene, _) in SHOWN.items()
    for picture in (name, *CROPS.get(name, ()))
}
COMMANDS |= {
    "images/record.svg": f"{FLEET} record",
    "images/rack.png": f"{FLEET} rack",
    "images/rack-unit.png": f"{FLEET} rack",
    "figures/magnetometer.png": f"{FLEET} magnetometer",
    "figures/tutorials/night.png": f"{TUTORIALS} a-night.md",
    "figures/tutorials/unit.png": f"{TUTORIALS} soak.md",
}
PICTURE = re.compile(
    r"^!\[[^]]+\]\((\S+)\)\n(?:\n\*.*\n(?:(?!<!--).+\n)*)?(?:<!-- (.*) -->\n)?", re.MULTILINE
)


def test_under_each_figure_stands_the_command_that_draws_it() -> None:
    used = set()
    for page in sorted(DOCS.rglob("*.md")):
        for picture, command in PICTURE.findall(page.read_text(encoding="utf-8")):
            name = (page.parent / picture).resolve().relative_to(DOCS).as_posix()
            assert command == COMMANDS[name], f"{page}: {name}"
            used.add(name)
    readme = set(re.findall(r"\(docs/(\S+\.png)\)", Path(ROOT / "README.md").read_text(encoding="utf-8")))
    there = {file.relative_to(DOCS).as_posix() for kind in ("png", "svg") for file in DOCS.rglob(f"*.{kind}")}
    assert used | readme == COMMANDS.keys() == there


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(DRAWN.keys() - {"closing-the-loop/chamber-cycle"}))
def test_each_figure_that_needs_no_measured_data_is_drawn(name: str) -> None:
    drawn = DRAWN[name]()
    assert drawn
    assert all(ax.has_data() for ax in drawn)
