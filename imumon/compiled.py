"""Compiled functions, kept on disk as numba does, and renewed when any file of their package has changed.

numba looks whether the one file of a function has changed.  A kernel is also made of what its module imports:
other kernels, and constants.  So here any file of the package counts (`package_stamp`).

What has to be compiled, and so keeps a command waiting, goes to the logger ``imumon.compiled``.
"""

import copyreg
import logging
from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import find_spec
from operator import getitem
from pathlib import Path
from typing import Any, TypeVar, cast, get_type_hints

import numba
import numpy as np
import numpy.typing as npt
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.extending import register_jitable

F = TypeVar("F", bound=Callable[..., Any])
Fields = TypeVar("Fields")

PACKAGE = __name__.partition(".")[0]

_log = logging.getLogger(__name__)
_announced: set[str] = set()
"""Modules of which it was logged that they are compiled."""


def njit(function: F, fastmath: bool | set[str] = False) -> F:
    """Compile a function as `numba.njit` does, without the interpreter's lock, and keep the code."""
    options: Any = {"nogil": True, "no_cfunc_wrapper": True, "fastmath": fastmath}
    kernel: Any = numba.njit(**options)(function)
    kernel._cache = _Cache(function)  # what numba's enable_caching does, with a cache of our own
    compiled: F = kernel
    return compiled


def inner(function: F) -> F:
    """Let compiled functions call this one; called from Python it is the plain function that it was.

    It is compiled as a part of the kernels that need it: without a way in from Python and a file of its own,
    a function of ten lines takes half as long.
    """
    part: F = register_jitable(no_cfunc_wrapper=True)(function)
    return part


_TYPES: dict[Any, type[np.generic]] = {
    int: np.int64,
    float: np.float64,
    npt.NDArray[np.int64]: np.int64,
    npt.NDArray[np.float64]: np.float64,
}


def record(fields: type[Fields], **shapes: int | tuple[int, ...]) -> Fields:
    """Return one NumPy record of zeros, of which compiled functions read and write the fields by name.

    `fields`: a class that annotates the fields as int, float, or an array of either.
    `shapes`: of the fields that are arrays.
    """
    return records(fields, 1, **shapes)[0]


def records(fields: type[Fields], count: int, **shapes: int | tuple[int, ...]) -> Sequence[Fields]:
    """Return an array of so many such records; no field may have the name of an attribute of `np.record`."""
    hints = get_type_hints(fields)
    layout = [(name, _TYPES[kind], shapes.get(name, ())) for name, kind in hints.items()]
    made: Any = np.zeros(count, np.dtype((np.record, layout)))
    return cast(Sequence[Fields], made)


def _stored(made: Any) -> tuple[Callable[..., Any], tuple[Any, int]]:
    """Have pickle store a record as part of an array."""
    array = made.base
    address = made.__array_interface__["data"][0] - array.__array_interface__["data"][0]
    return getitem, (array, address // array.itemsize)


copyreg.pickle(np.record, _stored)


@cache
def package_stamp(package: str) -> tuple[int, int]:
    """Return what changes with any source file of a package: newest change, ns, and their bytes."""
    spec = find_spec(package)
    folders = (spec and spec.submodule_search_locations) or ()
    files = [path.stat() for folder in folders for path in Path(folder).rglob("*.py")]
    return max((one.st_mtime_ns for one in files), default=0), sum(one.st_size for one in files)


class _Cache(FunctionCache):
    """The stored code of one function; logs what has to be compiled."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]  # numba's caches have no types
        self._module = function.__module__
        self._cache_file._source_stamp = package_stamp(self._module.partition(".")[0])

    def load_overload(self, sig: object, target_context: object) -> object:
        """Return the stored code for a signature, or None: then numba compiles.

        numba's own would first import all that it may need to compile, 0.2 s: this is what code needs to run.
        """
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                code = self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError):  # a class among the types of the stored arguments has gone
            self.flush()  # type: ignore[no-untyped-call]
            code = None
        if code is None and self._module not in _announced:
            _announced.add(self._module)
            _log.info("compiling %s (once)", self._module.removeprefix(f"{PACKAGE}."))
        return code
