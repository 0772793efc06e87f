"""The scripts of the docs still run: each imports, small runs go to their end, pages name what exists."""

from __future__ import annotations

import ast
import inspect
import os
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "scripts" / "reproduce"
COMMANDS = sorted(path.name for path in FOLDER.iterdir() if path.is_file() and os.access(path, os.X_OK))
LEFT_OUT = {"ablation", "plans", "measured"}
"""Parts whose smallest run takes minutes, or wants a recording."""
NAMED = re.compile(r"scripts/(\w+(?:/\w+)?)(?:\.py)?")


def commands() -> list[tuple[str, ...]]:
    """Return the small run of each command and part, of some seconds."""
    import study

    parts = [
        (command, *(["--part", part] if part else []))
        for command, known in study.STUDIES.items()
        for part in known
    ]
    return [one for one in parts if not LEFT_OUT & {*one}]


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tree with the scripts, whose docs may be written, and whose Python says what it would run."""
    folder = tmp_path_factory.mktemp("tree")
    for name in ("configs", "tests"):
        (folder / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "scripts", folder / "scripts", symlinks=True)
    shutil.copytree(ROOT / "docs", folder / "docs")
    program = folder / ".venv" / "bin" / "python"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\nprintf '%s\\n' \"$@\"\n")
    program.chmod(0o755)
    return folder


@pytest.fixture
def scripts(tree: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the scripts, which may be imported, and leave settings as they were."""
    folder = tree / "scripts" / "reproduce"
    monkeypatch.syspath_prepend(folder)
    for name, module in list(sys.modules.items()):  # of the repository, whose docs they would write
        if str(getattr(module, "__file__", "")).startswith(f"{ROOT / 'scripts'}{os.sep}"):
            monkeypatch.delitem(sys.modules, name)
    with patch.dict(os.environ):
        yield folder


def run(*command: str | Path) -> str:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_script_imports(scripts: Path) -> None:
    names = sorted(path.stem for path in scripts.glob("*.py"))
    assert names
    for name in names:
        import_module(name)


@pytest.mark.long
@pytest.mark.parametrize("command", commands(), ids=" ".join)
def test_a_small_run_goes_to_its_end(
    command: tuple[str, ...],
    scripts: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = run(scripts / command[0], *command[1:], "--quick").splitlines()
    assert arguments[-1] == "--quick"
    monkeypatch.setattr(sys, "argv", arguments)
    runpy.run_path(arguments[0], run_name="__main__")
    assert re.search(r"\d", capsys.readouterr().out)


def test_every_study_has_a_command() -> None:
    import study

    assert {*study.STUDIES, "study"} == set(COMMANDS)
    assert all((FOLDER / name).resolve() == FOLDER / "study" for name in study.STUDIES)


def test_pages_have_the_markers_of_their_studies(scripts: Path) -> None:
    import study

    for command, parts in study.STUDIES.items():
        for part, place in parts.items():
            page = study.study_of(place)[1].page
            text = (scripts.parents[1] / "docs" / page).read_text(encoding="utf-8") if page else ""
            assert not page or f"<!-- end {part or command} -->" in text, page


def called_as(module: ModuleType, name: str) -> bool:
    """Return whether other modules of its room, or of one beside, call a function as `module.name`."""
    call = f"{module.__name__.rpartition('.')[2]}.{name}("
    return any(call in path.read_text() for path in Path(str(module.__file__)).parents[1].rglob("*.py"))


@pytest.mark.parametrize("part", ["alignment", "attitude", "rest_and_bias", "temperature_rate"])
@pytest.mark.usefixtures("scripts")
def test_ablations_change_what_exists_and_is_read_in_a_run(part: str) -> None:
    import study

    module, _ = study.study_of(study.STUDIES["ablation"][part])
    for name, change in module.VARIANTS.items():
        assert all(hasattr(place, attribute) for place, attribute, _ in change), name
        for place, attribute, _ in change:
            if isinstance(place, ModuleType):  # what only other constants are made of has no effect later
                nodes = ast.walk(ast.parse(inspect.getsource(place)))
                functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.Lambda)]
                read = {n.id for one in functions for n in ast.walk(one) if isinstance(n, ast.Name)}
                assert attribute in read or called_as(place, attribute), f"{name}: {attribute}"


def test_commands_that_the_docs_name_exist() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    for page in pages:
        for name in NAMED.findall(page.read_text(encoding="utf-8")):
            paths = [ROOT / "scripts" / name, ROOT / "scripts" / f"{name}.py"]
            assert any(path.exists() for path in paths), f"{page.name}: scripts/{name}"


def test_parts_that_the_docs_name_exist() -> None:
    import study

    for page in (ROOT / "docs").rglob("*.md"):
        for part in re.findall(r"closing_the_loop(?:` \()? --part (\w+)", page.read_text(encoding="utf-8")):
            assert part in study.STUDIES["closing_the_loop"], f"{page.name}: --part {part}"


def test_tables_are_written_between_markers(tmp_path: Path) -> None:
    import study

    page = tmp_path / "page.md"
    page.write_text("before\n<!-- one -->\nold\n<!-- end one -->\nafter\n", encoding="utf-8")
    table = study.Table("Title", ["a", "b"], [["1", "2"]]).markdown()
    study.write_between(page, "one", table)
    assert page.read_text(encoding="utf-8") == (
        "before\n<!-- one -->\nTitle\n\n| a | b |\n|---|---|\n| 1 | 2 |\n<!-- end one -->\nafter\n"
    )
