"""Workers as jobs of a queue, as the page of the batch has them, with a stand-in for the queue's commands."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.cli.command import answer
from tests.fleet.batch.sessions import tiny
from tests.waiting import LIMIT_S, wait_until

PAGE = Path(__file__).resolve().parents[3] / "docs" / "batch.md"
WORKERS = 1
SUBMIT = """#!/bin/sh
job={folder}/$$.job
cp "$1" "$job"
setsid sh "$job" >"$job.said" 2>&1 &
echo $! >"$job.pid"
echo "Submitted batch job $!"
"""
"""Runs what it is given at once, and says the number of the job as the queue does."""
CANCEL = """#!/bin/sh
kill -- -"$1"
"""
QUEUES = {
    "SLURM": ("sbatch", "scancel", ["#SBATCH --cpus-per-task=1", "#SBATCH --mem=4G", "#SBATCH -t 08:00:00"]),
    "PBS": ("qsub", "qdel", ["#PBS -l select=1:ncpus=1:mem=3815MB", "#PBS -l walltime=08:00:00"]),
}


def program(queue: str, port: int) -> str:
    """Return the program of the page, for this queue, on a port that is free, and with fewer workers."""
    programs = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (found,) = (text for text in programs if "dask_jobqueue" in text)
    for old, new in (
        ("SLURM", queue),
        ("slurm", queue.lower()),
        ("jobs=100", f"jobs={WORKERS}"),
        ("8786", str(port)),
    ):
        assert old in found
        found = found.replace(old, new)
    return str(found)


@pytest.mark.long
@pytest.mark.parametrize("queue", QUEUES)
def test_a_batch_on_workers_that_a_queue_began(queue: str, tmp_path: Path) -> None:
    submit, cancel, asked = QUEUES[queue]
    for name, text in ((submit, SUBMIT), (cancel, CANCEL)):
        (tmp_path / name).write_text(text.format(folder=tmp_path))
        (tmp_path / name).chmod(0o755)
    first = tiny(tmp_path / "lab" / "0")
    for number in range(1, 4):
        shutil.copytree(first, tmp_path / "lab" / str(number))
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    (tmp_path / "cluster.py").write_text(program(queue, port))
    cluster = subprocess.Popen(
        [sys.executable, tmp_path / "cluster.py"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
    )
    assert cluster.stdout is not None
    try:
        said: list[str] = []
        while not said or "Enter ends" not in said[-1]:
            said.append(cluster.stdout.readline())
            assert said[-1], said
        address = said[-1].partition(";")[0]
        told = answer("batch", "decode", tmp_path / "lab", "--out", tmp_path / "out", "--scheduler", address)
        assert (told["sessions"], told["failed"]) == (4, {})
        jobs = [path.read_text() for path in tmp_path.glob("*.job")]
        assert len(jobs) == WORKERS
        for job in jobs:
            assert all(line in job.splitlines() for line in asked)
            assert "--nthreads 1 " in job  # of which --timeout of a batch takes advantage
            assert "--nanny" in job
        cluster.communicate("\n", timeout=LIMIT_S)
        assert cluster.returncode == 0
        assert wait_until(lambda: not any(map(psutil.pid_exists, pids(tmp_path))))
    finally:
        cluster.kill()
        cluster.wait()
        for pid in pids(tmp_path):
            if psutil.pid_exists(pid):
                os.killpg(pid, signal.SIGKILL)


def pids(folder: Path) -> list[int]:
    """Return the numbers of the jobs, which are those of their groups."""
    return [int(path.read_text()) for path in folder.glob("*.pid")]
