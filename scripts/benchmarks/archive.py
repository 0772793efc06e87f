"""The table of a batch of a million sessions: its size, and what it takes to find something in it."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.measure import Bar, Table
from imumon.fleet.batch.dataset import RESULTS, ROWS, schema_of

SESSIONS, PARTS = 1_000_000, 270
"""Files: a batch of a day writes so many (`imumon.fleet.batch.dataset.WRITE_SHARE`)."""
CHANNELS = [f"{kind}_{axis}" for kind in ("gyro", "accel", "mag") for axis in "xyz"]
COMMAND = "allan"
TASKS = {
    "to find out what is done already": "from imumon.fleet.batch.dataset import Dataset\n"
    "from imumon.fleet.batch.options import BatchOptions\nimport sys\nfrom pathlib import Path\n"
    "assert len(Dataset(Path(sys.argv[1]), BatchOptions(command='allan')).done()) == int(sys.argv[2])",
    "to find what failed": "from imumon.fleet.batch.dataset import Dataset\n"
    "from imumon.fleet.batch.options import BatchOptions\nimport sys\nfrom pathlib import Path\n"
    "assert not Dataset(Path(sys.argv[1]), BatchOptions(command='allan')).failures()",
    "a median per channel of all rows in DuckDB": "import duckdb, sys\n"
    "rows = duckdb.sql(f\"select channel, median(angle_random_walk) from '{sys.argv[1]}/rows/*.parquet'\"\n"
    "                  ' group by channel').fetchall()\nassert len(rows) == 9",
    "nothing but the imports": "import duckdb, sys\nfrom pathlib import Path\n"
    "from imumon.fleet.batch.dataset import Dataset\nfrom imumon.fleet.batch.options import BatchOptions",
}
MEMORY = "\nimport resource\nprint(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"


def run() -> tuple[list[Table], list[Bar]]:
    """Write the table, with numbers that are noise, and measure each task in a process of its own."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / ROWS).mkdir()
        random, first = np.random.default_rng(0), 0
        for number, last in enumerate(np.linspace(0, SESSIONS, PARTS + 1).astype(int)[1:].tolist(), 1):
            table = rows_of(first, last, random)
            pq.write_table(table, folder / ROWS / f"part-{number:06}.parquet", compression="zstd")
            first = last
        size = sum(path.stat().st_size for path in (folder / ROWS).iterdir())
        table = Table(
            f"The table of {SESSIONS:,} sessions of {len(CHANNELS)} channels ({COMMAND})",
            ["", "CPU s", "GB of memory"],
        )
        table.rows = [[what, *_measured(program, folder)] for what, program in TASKS.items()]
    table.notes = [f"{size / SESSIONS / 1e3:.2f} kB a session, {size / 1e9:.2f} GB in {PARTS} files"]
    return [table], []


def rows_of(first: int, last: int, random: np.random.Generator) -> pa.Table:
    """Return the rows of these sessions."""
    count = (last - first) * len(CHANNELS)
    sessions = [f"/lab/sessions/20260101T000000Z-{number:07}" for number in range(first, last)]
    made = {
        "session": pa.array(np.repeat(sessions, len(CHANNELS))),
        "device": pa.array(["ax1"] * count),
        "serial": pa.array(
            np.repeat([f"SN{number % 1000:03}" for number in range(first, last)], len(CHANNELS))
        ),
        "channel": pa.array(CHANNELS * (last - first)),
        "unit": pa.array(["rad/s"] * count),
    }
    made |= {name: pa.array(random.normal(size=count)) for name, _ in RESULTS[COMMAND]}
    schema = schema_of(COMMAND)
    return pa.table([made.get(field.name, pa.nulls(count, field.type)) for field in schema], schema=schema)


def _measured(program: str, folder: Path) -> tuple[str, str]:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    arguments = [sys.executable, "-c", program + MEMORY, str(folder), str(SESSIONS)]
    done = subprocess.run(arguments, check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return f"{spent:.1f}", f"{int(done.stdout) * 1024 / 1e9:.2f}"
