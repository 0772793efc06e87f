"""The tutorials and how-to pages of the docs, run by tests; as a program it writes their outputs anew.

A page has blocks of commands (```sh) and, behind some, what they print (```text).  There a line `...` stands
for lines that are left out.  Pictures of a page that a command draws have the name of the picture's file.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *sorted((ROOT / "docs" / "tutorials").glob("*.md")),
    *sorted((ROOT / "docs" / "how-to").glob("*.md")),
]
PICTURES = ROOT / "docs" / "figures" / "tutorials"
BLOCK = re.compile(r"```sh\n(?P<commands>.*?)```\n(?:\n```text\n(?P<printed>.*?)```\n)?", re.DOTALL)
NUMBER = re.compile(r"[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
PROGRESS = re.compile(r"INFO  (compiling|reading|\w+ing) |WARN  the machine|.*\r")
"""Lines that depend on the machine."""
TOLERANCE = 0.1
"""Of a number, as a share: other versions of the libraries round in another place."""
LONGEST_S = 500.0
"""Of a page."""
MARK = "--- next block of the page ---"
"""What the shell prints before each block."""


@dataclass(frozen=True)
class Ran:
    """A block of a page, and what its commands printed this time."""

    commands: str
    expected: str | None
    printed: str


def run(page: Path, folder: Path) -> list[Ran]:
    """Run the blocks of a page in a folder, all in one shell; raises RuntimeError where a command fails.

    What was started in the background ends with the page; the link of a virtual device is waited for.
    """
    blocks = list(BLOCK.finditer(page.read_text(encoding="utf-8")))
    waits = r"\g<0>until [ -e \1 ]; do sleep 0.05; done\n"
    steps = (re.sub(r".*--link (\S+).*&\n", waits, block["commands"]) for block in blocks)
    printed = _printed("\n".join(f"echo {MARK}\n{step}" for step in steps), folder)
    parts = printed.split(f"{MARK}\n")[1:]
    return [Ran(block["commands"], block["printed"], one) for block, one in zip(blocks, parts, strict=True)]


def _printed(script: str, folder: Path) -> str:
    """Return what a script prints on both outputs; it finds this checkout's imumon, and its Python."""
    tools = folder / ".bin"
    tools.mkdir()
    for name, arguments in {"imumon": "-m imumon ", "python": ""}.items():
        start = tools / name
        start.write_text(f'#!/bin/sh\nexec "{sys.executable}" {arguments}"$@"\n', encoding="utf-8")
        start.chmod(0o755)
    path = f"{tools}{os.pathsep}{os.environ['PATH']}"
    found = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PATH": path, "COLUMNS": "100", "PYTHONPATH": found}
    ended = subprocess.run(
        ["bash", "-e", "-c", f"trap 'kill $(jobs -p) 2>/dev/null || true; wait' EXIT\n{script}"],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=LONGEST_S,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise RuntimeError(f"exit code {ended.returncode}\n{ended.stdout}")
    return ended.stdout


def missing_lines(ran: Ran) -> list[str]:
    """Return the lines of a page that the commands did not print, in this order, this time."""
    printed = iter(_normal(ran.printed).splitlines())
    wanted = [line for line in _normal(ran.expected or "").splitlines() if line and line != "..."]
    return [line for line in wanted if not any(_alike(line, one) for one in printed)]


def _normal(text: str) -> str:
    return "\n".join(" ".join(line.split()) for line in text.splitlines())


def _alike(one: str, other: str) -> bool:
    """Return whether two lines differ by no more than `TOLERANCE` of their numbers."""
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    values = [(float(a.replace(",", "")), float(b.replace(",", ""))) for a, b in pairs]
    return all(abs(a - b) <= TOLERANCE * max(abs(a), abs(b), 1.0) for a, b in values)


def write(page: Path) -> None:
    """Write a page's outputs and pictures anew; a block that has `...` is left as it is."""
    with tempfile.TemporaryDirectory(prefix="imumon-tutorial-") as name:
        folder = Path(name)
        text = page.read_text(encoding="utf-8")
        for ran in run(page, folder):
            if ran.expected is not None and "..." not in ran.expected:
                old, new = (
                    f"{ran.commands}```\n\n```text\n{one}```\n" for one in (ran.expected, _shown(ran.printed))
                )
                text = text.replace(old, new, 1)
        page.write_text(text, encoding="utf-8")
        for picture in re.findall(r"\(\.\./figures/tutorials/([\w-]+\.png)\)", text):
            if (folder / picture).exists():
                PICTURES.mkdir(parents=True, exist_ok=True)
                shutil.copy(folder / picture, PICTURES / picture)


def _shown(printed: str) -> str:
    """Return what a page shows: without progress and compilation, which depend on the machine."""
    lines = [line.rstrip() for line in printed.splitlines()]
    kept = [line for line in lines if not PROGRESS.match(line)]
    return "\n".join(kept).strip("\n") + "\n"


if __name__ == "__main__":
    for one in [page for page in PAGES if page.name in sys.argv[1:]] or PAGES:
        write(one)
        print(f"{one.relative_to(ROOT)} written")
