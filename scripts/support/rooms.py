"""The drawing of core and wings in docs/architecture.md, made from the imports, and the lines of each room.

python scripts/support/rooms.py [--write]   (--write: into the page)
"""

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from imumon.wing import BUILT_IN

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "imumon"
PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- rooms -->\n", "<!-- end rooms -->"
ROOMS = {
    "lab": (10_008, "bias models from recordings, what they lack, plans, learning, hard and soft iron"),
    "estimation": (
        13_428,
        "temperature rate, rest, gyro bias, alignment, attitude, smoothing, each with a sigma",
    ),
    "protocols": (
        8_026,
        "one framing engine; 18 device families as tables beside the makers' documents; proposals",
    ),
    "recordings": (
        4_881,
        "every byte with its time, kept through kill and damage; tables in and out; import",
    ),
    "view": (5_221, "Rerun: panels, pages for browsers, the terminal, pictures of recordings"),
    "fleet": (3_175, "many devices at once; one command over many sessions; units and their records"),
    "cli": (2_714, "a file for each command of the core"),
    "configure": (2_772, "settings of four device families, and virtual devices that answer"),
    "run": (2_093, "live and replay: threads, states, advice, summaries, the pipeline file"),
    "allan": (2_528, "noise terms with uncertainties, through gaps, filters and disturbances"),
    "papers": (2_338, "the published methods as printed, beside the defaults"),
    "simulation": (2_131, "units, chambers, motion, virtual ports"),
    "effects": (1_806, "one physical effect a file, for simulation, search and live use"),
    "transport": (1_497, "ports: open, read, reconnect, detect; who holds them"),
    "clock": (1_188, "device clock to host clock, restarts, wraps, repeated packets"),
    "logs": (953, "logs of autopilots and ROS bags"),
    "models": (928, "bias over temperature: curves, the model file, its prediction"),
    "library": (870, "what `import imumon` offers"),
    "filters": (1_307, "slots of samples, turns by gyros, Kalman steps, noise"),
    "publishing": (797, "live samples for Foxglove, ROS 2 and UDP"),
}
"""Lines of each room before the rewriting of November 2026, counted where they are now; what it gives."""
BEFORE = 70_293
"""Lines of the package then."""


def wings() -> list[str]:
    """Return the names of the wings of imumon, as imumon/wing.py lists them."""
    return [name.rpartition(".")[2] for name in BUILT_IN]


def room_of(path: Path) -> str:
    """Return the room of a file: its folder in the package, or the file itself."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path: Path) -> Iterator[str]:
    """Yield the rooms that a file imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("imumon."):
            yield str(node.module).split(".")[1]


def lines_of_rooms() -> Counter[str]:
    """Return how many lines each room has."""
    lines = Counter[str]()
    for path in sorted(PACKAGE.rglob("*.py")):
        lines[room_of(path)] += len(path.read_text(encoding="utf-8").splitlines())
    return lines


def needs() -> dict[str, list[str]]:
    """Return the rooms that each wing imports, in order of name."""
    found: dict[str, set[str]] = {wing: set() for wing in wings()}
    for path in PACKAGE.rglob("*.py"):
        if (room := room_of(path)) in found:
            found[room] |= {name for name in imported(path) if (PACKAGE / name).is_dir() and name != room}
    return {wing: sorted(rooms) for wing, rooms in found.items()}


def drawing() -> str:
    """Return the drawing and the table as Markdown."""
    lines, made = lines_of_rooms(), wings()
    core = {room: n for room, n in lines.items() if room not in made}
    text = ["    core" + f"{sum(core.values()):>36,} lines; imports no wing"]
    for wing, rooms in needs().items():
        of_core = ", ".join(room for room in rooms if room not in made)
        of_wings = ", ".join(room for room in rooms if room in made)
        text.append("      ^")
        text.append(f"      +-- {wing:<12}{lines[wing]:>22,} lines; of the core: {of_core}")
        if of_wings:
            text.append(f"      |   {'':<12}{'':>22}        of wings: {of_wings}")
    table = [
        "| room | lines | before November 2026 | core or wing | what it gives |",
        "|---|---:|---:|---|---|",
    ]
    for room in sorted(ROOMS, key=lambda room: -lines[room]):
        before, gives = ROOMS[room]
        wing = "wing" if room in made else ""
        table.append(f"| `{room}` | {lines[room]:,} | {before:,} | {wing} | {gives} |")
    rest = [n for room, n in lines.items() if room not in ROOMS]
    table.append(
        f"| {len(rest)} files beside them | {sum(rest):,} | | | the pipeline, blocks, units, files |"
    )
    table.append(f"| all | {sum(lines.values()):,} | {BEFORE:,} | | |")
    return "\n".join([*text, "", *table, ""])


def main(arguments: list[str]) -> int:
    """Print the drawing, or write it into the page."""
    if arguments != ["--write"]:
        print(drawing())
        return 0
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text(f"{before}{BEGIN}{drawing()}{END}{after}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
