"""Takes the part of `closing_the_loop` that is asked for."""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
QUICK = "ten columns, white"
DATA = Path(os.environ.get("IMUMON_DATA", ROOT.parent / "shared" / "data"))
DOCS = ROOT / "docs"


def main() -> int:
    """Run one part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parts = ("steps", "simulated", "live", "limits", "paired", "plans", "measured", "heading", "ablation")
    parser.add_argument("--part", choices=parts, default="simulated")
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    parser.add_argument("data", nargs="?", type=Path, default=DATA, help="folder of the measured recordings")
    parser.add_argument(
        "--repeat",
        type=int,
        default=4,
        help="simulated, live, limits, paired, plans: cases of each kind",
    )
    parser.add_argument(
        "--first",
        type=int,
        help="first seed: simulated 0, live 2500, limits 71000, paired 500000, plans and ablation 900",
    )
    parser.add_argument("--minutes", type=float, default=math.inf, help="simulated: begin no case after")
    parser.add_argument("--jobs", type=int, default=2, help="simulated, live, plans: processes")
    given = parser.parse_args()
    if given.part == "steps":
        from closing_the_loop_steps import main as steps

        return steps(DOCS / "figures" / "closing-the-loop")
    if given.part == "simulated":
        from closing_the_loop_statistics import main as statistics

        if given.quick:
            return statistics(["--repeat", "1", "--jobs", "1", "--only", QUICK])
        out = DOCS / "appendix" / "closing-the-loop-results.md"
        numbers = {"repeat": given.repeat, "first": given.first or 0}
        numbers |= {"minutes": given.minutes, "jobs": given.jobs}
        options = [text for name, value in numbers.items() for text in (f"--{name}", str(value))]
        return statistics([*options, "--out", str(out)])
    if given.part == "live":
        from closing_the_loop_live import main as live

        if given.quick:
            return live(["--repeat", "1", "--only", "driven: load"])
        first = 2500 if given.first is None else given.first
        out = DOCS / "appendix" / "closing-the-loop-live.md"
        options = ["--repeat", str(given.repeat), "--first", str(first), "--jobs", str(given.jobs)]
        return live([*options, "--out", str(out)])
    if given.part == "limits":
        from closing_the_loop_limits import main as limits

        first = 71000 if given.first is None else given.first
        return limits(["--repeat", str(1 if given.quick else given.repeat), "--first", str(first)])
    if given.part == "paired":
        from closing_the_loop_paired import paired

        first = 500000 if given.first is None else given.first
        return paired(1 if given.quick else given.repeat, first, quick=given.quick)
    first = 900 if given.first is None else given.first
    if given.part == "plans":
        from closing_the_loop_plans import plans

        return plans(given.repeat, first, given.jobs, quick=given.quick)
    if given.part == "ablation":
        from closing_the_loop_ablation import ablation

        return ablation(given.repeat, first, given.jobs, given.data, quick=given.quick)
    if given.part == "measured":
        from closing_the_loop_measured import measured

        return measured(given.data, DOCS / "figures" / "closing-the-loop")
    from closing_the_loop_heading import heading

    return heading()


if __name__ == "__main__":
    sys.exit(main())
