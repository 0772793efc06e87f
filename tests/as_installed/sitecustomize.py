"""Programs that tests start find what a user's environment has.

Pandas is there for tests alone, and pyarrow loads it wherever it is, for 0.3 s in each program.
"""

from __future__ import annotations

import sys


class _Absent:
    def find_spec(self, fullname: str, *_: object) -> None:
        if fullname == "pandas":
            raise ModuleNotFoundError("no pandas, as for a user", name=fullname)


sys.meta_path.insert(0, _Absent())
