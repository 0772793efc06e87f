"""Install imumon as users do, into empty environments outside the checkout, and use it there.

Needs a network, and `uv` and `pipx` for two of the ways: scripts/install_check [WAY ...]
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import venv
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
USES = (
    "--version",
    "doctor",
    "devices",
    "demo --seconds 5 --view none --out session",
    "replay session",
    "allan session",
)
"""Commands that are run, in this order."""
MAY_SAY_NO = ("doctor",)
"""Commands whose exit code 1 is an answer: what this computer lacks."""


def by_pip(folder: Path, what: str) -> Path:
    """Install a path by pip into an empty environment; return the command."""
    venv.create(folder / "env", with_pip=True)
    _run([str(folder / "env/bin/python"), "-m", "pip", "install", "--quiet", what], folder)
    return folder / "env/bin/imumon"


def wheel(folder: Path) -> Path:
    """Build a wheel, and install it."""
    return by_pip(folder, _built(folder, "wheel"))


def sdist(folder: Path) -> Path:
    """Build a source distribution, and install it."""
    return by_pip(folder, _built(folder, "sdist"))


def checkout(folder: Path) -> Path:
    """Install the checkout, as ``pip install .`` does."""
    return by_pip(folder, str(ROOT))


def pipx(folder: Path) -> Path:
    """Install by ``pipx install .``."""
    _run(
        ["pipx", "install", str(ROOT)],
        folder,
        PIPX_HOME=str(folder / "pipx"),
        PIPX_BIN_DIR=str(folder / "bin"),
    )
    return folder / "bin/imumon"


def uv(folder: Path) -> Path:
    """Install by ``uv tool install .``."""
    _run(
        ["uv", "tool", "install", "--python", sys.executable, str(ROOT)],
        folder,
        UV_TOOL_DIR=str(folder / "uv"),
        UV_TOOL_BIN_DIR=str(folder / "bin"),
    )
    return folder / "bin/imumon"


WAYS: dict[str, Callable[[Path], Path]] = {one.__name__: one for one in (wheel, sdist, checkout, pipx, uv)}


def _built(folder: Path, kind: str) -> str:
    """Return the path of a wheel or source distribution of the checkout."""
    python = str(ROOT / ".venv/bin/python")
    _run([python, "-m", "hatchling", "build", "-t", kind, "-d", str(folder / "dist")], ROOT)
    return str(next((folder / "dist").iterdir()))


def _run(command: list[str], folder: Path, **more: str) -> str:
    """Return what a command prints; raises CalledProcessError where it fails."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | more
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode and not (done.returncode == 1 and command[1:2] == [*MAY_SAY_NO]):
        print(done.stdout, done.stderr, file=sys.stderr)
        done.check_returncode()
    return done.stdout


def main(names: list[str]) -> None:
    """Install and use imumon in each of these ways; all whose program is here without names."""
    for name in names or [one for one in WAYS if one not in ("pipx", "uv") or shutil.which(one)]:
        with tempfile.TemporaryDirectory(prefix=f"imumon-{name}-") as folder:
            imumon = WAYS[name](Path(folder))
            for use in USES:
                _run([str(imumon), *use.split()], Path(folder))
        print(f"{name}: {len(USES)} commands work")


if __name__ == "__main__":
    main(sys.argv[1:])
