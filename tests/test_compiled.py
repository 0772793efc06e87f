"""Compiled code is kept, and made anew when a file of its package has changed."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from pathlib import Path

import numba
import pytest

FILES = {
    "__init__.py": "",
    "constants.py": "FACTOR = 2.0\n",
    "inner.py": """
        from imumon.compiled import njit
        from made.constants import FACTOR

        @njit
        def scaled(x: float) -> float:
            return FACTOR * x
        """,
    "outer.py": """
        from __future__ import annotations
        from typing import TYPE_CHECKING
        from imumon.compiled import njit
        from made import (
            inner,
        )
        if TYPE_CHECKING:
            from made.unrelated import Thing
        scaled = inner.scaled

        @njit
        def shifted(x: float) -> float:
            return scaled(x) + 1.0
        """,
    "unrelated.py": """
        from imumon.compiled import njit

        Thing = float

        @njit
        def halved(x: float) -> float:
            return x / 2.0
        """,
}
RUN = """
import logging
logging.basicConfig(level=logging.INFO, format="%(message)s")
from made.outer import shifted
from made.unrelated import halved
print(shifted(3.0), halved(3.0))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with kernels that call kernels of other modules."""
    folder = tmp_path / "made"
    folder.mkdir()
    for name, text in FILES.items():
        lines = text.splitlines()
        (folder / name).write_text("\n".join(line.removeprefix(" " * 8) for line in lines) + "\n")
    return folder


def run(package: Path, **environment: str) -> tuple[str, list[str]]:
    """Run the kernels in a new process; return what they gave, and which modules were compiled."""
    path = f"{package.parent}:{Path(__file__).parents[1]}"
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        env={"PYTHONPATH": path, "PATH": "/usr/bin:/bin", "HOME": str(package.parent), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip(), sorted(re.findall(r"^compiling (?:made\.)?(\w+)", done.stderr, re.MULTILINE))


@pytest.mark.long
def test_an_edit_of_any_file_and_an_index_that_names_a_lost_class_compile_anew(package: Path) -> None:
    assert run(package) == ("7.0 1.5", ["inner", "outer", "unrelated"])
    assert run(package) == ("7.0 1.5", [])
    (package / "constants.py").write_text("FACTOR = 5.0\n")
    assert run(package) == ("16.0 1.5", ["inner", "outer", "unrelated"])
    # The types of the arguments stand in the index; one of them may have been renamed since.
    for index in package.rglob("*.nbi"):
        version = pickle.dumps(numba.__version__, protocol=-1)
        index.write_bytes(version + b"cmade.gone\nGone\n.")
    assert run(package) == ("16.0 1.5", ["inner", "outer", "unrelated"])
    assert run(package) == ("16.0 1.5", [])


@pytest.mark.long
def test_code_of_a_package_that_cannot_be_written_is_kept_elsewhere(package: Path, tmp_path: Path) -> None:
    (package / "__pycache__").write_text(
        "a file where the folder would be, as nobody stops root from writing"
    )
    assert run(package)[1] == ["inner", "outer", "unrelated"]
    assert run(package)[1] == []
    assert list((tmp_path / ".cache").rglob("*.nbi"))
