"""Compile what has changed since the last time, so that a start is like any other.

What is done goes to standard error.  Nothing is deleted: numba renews each kernel (imumon/compiled.py).
"""

import io
import platform
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from importlib.metadata import version
from pathlib import Path
from time import monotonic

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from imumon.compiled import package_stamp  # noqa: E402  (of this clone, whichever is installed)

DONE = ROOT / "imumon" / "__pycache__" / "kernels"
"""State of the package when the kernels were last compiled; beside the kernels, so deleted with them."""


def main() -> None:
    """Compile the kernels, where anything has changed, by commands that together need all of them."""
    now = f"{package_stamp('imumon')} numba {version('numba')} Python {platform.python_version()}"
    now += f" on {platform.node()}"
    if DONE.exists() and DONE.read_text() == now:
        return
    from imumon.cli import cli
    from imumon.protocols.device import load_device
    from imumon.run.live import warm_up
    from imumon.run.setup import Setup

    began, unread = monotonic(), io.StringIO()
    warm_up(load_device("ax1"), Setup(latitude_deg=45.0))
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(unread), redirect_stderr(unread):
        scenario = "simulate crs05-ramp-hysteresis --duration 60 --rate 100 --out"
        for command in (
            f"{scenario} {folder}/table.parquet",
            f"allan {folder}/table.parquet",
            f"{scenario} {folder}/session --device xsens",
            f"replay {folder}/session --latitude 45",
        ):
            cli.main(command.split(), standalone_mode=False)
    print(f"compiled kernels ({monotonic() - began:.0f} s)", file=sys.stderr)
    DONE.parent.mkdir(exist_ok=True)
    DONE.write_text(now)


if __name__ == "__main__":
    main()
