"""What a module is made of: its own source and those of all modules of its package that it imports."""

from __future__ import annotations

import hashlib
import re
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_IMPORT = re.compile(r"^from ([\w.]+) import (\([^)]*\)|[^\n]*)|^import ([\w.]+)", re.MULTILINE)


def closure(module: str) -> tuple[str, ...]:
    """Return the module and all modules of its package that it imports, directly or not, in order of name.

    Imports for type checking and inside functions do not count: compiled code cannot depend on them.
    """
    found, waiting = set[str](), [module]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += _imports(name)
    return tuple(sorted(found))


@cache
def stamp(module: str) -> str:
    """Return the fingerprint of all the sources that the compiled functions of a module may be made of."""
    fingerprint = hashlib.sha256()
    for name in closure(module):
        fingerprint.update(f"{name}\0{_source(name)}\0".encode())
    return fingerprint.hexdigest()


@cache
def _source(module: str) -> str:
    path = _file(module)
    return path.read_text(encoding="utf-8") if path is not None else ""


def _file(module: str) -> Path | None:
    """Return where the source of a module is; looked for by hand, as Python's finders import its packages."""
    package, *names = module.split(".")
    found = sys.modules.get(package)
    spec = find_spec(package) if found is None else found.__spec__
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        path = Path(folder, *names)
        for file in (path / "__init__.py", path.with_suffix(".py")):
            if file.is_file():
                return file
    return None


@cache
def _imports(module: str) -> tuple[str, ...]:
    """Return the modules of the same package that a module imports as it is imported itself."""
    package, found = module.partition(".")[0], list[str]()
    for source, names, plain in _IMPORT.findall(_source(module)):
        name = source or plain
        if name.partition(".")[0] == package:
            children = [f"{name}.{child}" for child in re.findall(r"\w+", names)]
            found += [name, *(child for child in children if child != module and _file(child) is not None)]
    return tuple(found)
