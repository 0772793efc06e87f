"""Programs that tests start find what a user's environment has.

Pandas is there for tests alone, and pyarrow loads it wherever it is, for 0.3 s in each program.  SciPy loads
NumPy's f2py, which nothing here uses, for another 0.1 s.
"""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec


class _Quick:
    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        if fullname == "pandas":
            raise ModuleNotFoundError("no pandas, as for a user", name=fullname)
        return ModuleSpec(fullname, self) if fullname == "numpy.f2py" else None  # type: ignore[arg-type]

    def create_module(self, _: ModuleSpec) -> None: ...

    def exec_module(self, _: object) -> None: ...


sys.meta_path.insert(0, _Quick())
