"""Programs that tests start find what a user's environment has.

Pandas is there for tests alone, and pyarrow loads it wherever it is, for 0.3 s in each program.
"""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder


class _Absent(MetaPathFinder):
    def find_spec(self, fullname: str, path: object = None, target: object = None) -> None:
        if fullname == "pandas":
            raise ModuleNotFoundError("no pandas, as for a user", name=fullname)


sys.meta_path.insert(0, _Absent())
