"""What a first start has to compile: CPU seconds of each kernel, with an empty cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from time import process_time
from typing import Any

from support.compile_kernels import TASKS

from benchmarks.measure import Bar, Table

DEMO = ("epochs and clocks", "estimators")
"""What scripts/demo needs."""
LONGEST = 15
"""Kernels that the table names."""


def run() -> tuple[list[Table], list[Bar]]:
    """Compile everything in a process with an empty cache, task after task."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder}
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.compilation"],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
    found: dict[str, dict[str, float]] = json.loads(done.stdout.splitlines()[-1])
    totals = {task: sum(kernels.values()) for task, kernels in found.items()}
    kernels = sorted(((s, name) for task in found.values() for name, s in task.items()), reverse=True)
    first = Table("Compilation with an empty cache, one task after the other", ["task", "CPU s", "kernels"])
    first.rows = [[task, f"{totals[task]:.1f}", str(len(found[task]))] for task in found]
    first.rows.append(["all", f"{sum(totals.values()):.1f}", str(len(kernels))])
    first.notes.append(
        "what a task has compiled the next ones need not; functions of numba's own are included"
    )
    second = Table(
        f"The {LONGEST} kernels that take longest, without the kernels they call", ["kernel", "CPU s"]
    )
    second.rows = [[name, f"{seconds:.2f}"] for seconds, name in kernels[:LONGEST]]
    return [first, second], [
        Bar("compilation that scripts/demo waits for, CPU s", 8, sum(totals[t] for t in DEMO), at_most=True),
        Bar("compilation of everything, CPU s", 10, sum(totals.values()), at_most=True),
    ]


def main() -> None:
    """Print, as JSON, the CPU seconds of each kernel in each task."""
    from numba.core import event

    found: dict[str, dict[str, float]] = {}
    running: list[list[float]] = []  # of each compilation under way: when it began, and what was within it

    class Listener(event.Listener):
        def on_start(self, _: Any) -> None:
            running.append([process_time(), 0.0])

        def on_end(self, ended: Any) -> None:
            began, inner = running.pop()
            seconds = process_time() - began
            if running:
                running[-1][1] += seconds
            function = ended.data["dispatcher"].py_func
            kernels[f"{function.__module__}.{function.__name__}"] += seconds - inner

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]  # numba has no types here
    for name, task in TASKS.items():
        kernels: defaultdict[str, float] = defaultdict(float)
        found[name] = kernels
        task()
    print(json.dumps(found))


if __name__ == "__main__":
    main()
