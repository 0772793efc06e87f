"""Search for hostile inputs by the code that they reach, where atheris is installed (it is no requirement).

    python -m tests.faults.guided TARGET [options of libFuzzer, as -max_total_time=600]

The targets are those of `tests.faults.fuzz`; kernels that are compiled are not seen from inside.
"""

from __future__ import annotations

import sys

import atheris  # type: ignore[import-untyped,import-not-found,unused-ignore]

with atheris.instrument_imports(include=["imumon", "yaml"], enable_loader_override=False):
    from tests.faults.fuzz import Target, attempt, targets


def main() -> None:
    """Let atheris search."""
    target: Target = targets()[sys.argv.pop(1)]

    def one(data: bytes) -> None:
        if said := attempt(target, data):
            raise AssertionError(said)

    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
