"""A batch with workers of Dask, as a whole."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from imumon.errors import ImumonError, Reason
from imumon.fleet.batch import running
from imumon.fleet.batch.dataset import RESULTS, ROWS, BatchOptions, Dataset, Row, schema_of
from imumon.fleet.batch.running import run_jobs, workers
from imumon.fleet.batch.tasks import Job, limited, work
from tests.cli.command import IMUMON, answer, imumon
from tests.fleet.batch.sessions import tiny
from tests.lab.calibration.records import few_steps
from tests.waiting import LIMIT_S, wait_until

DECODE = BatchOptions(command="decode")


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve sessions of the same bytes, one that has no data, and one that is no session."""
    folder = tmp_path_factory.mktemp("batch") / "sessions"
    first = tiny(folder / "s00")
    for number in range(1, 12):
        shutil.copytree(first, folder / f"s{number:02}")
    (folder / "s05" / "wire.mcap").unlink()
    (folder / "s07" / "session.yaml").write_text("format: nothing of ours\n")
    return folder


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with workers(None, 2) as made:
        # A task has failed when it killed two workers, not four as by default: each takes seconds to start.
        made.cluster.scheduler.allowed_failures = 1
        yield made


def table(out: Path) -> list[Row]:
    rows = pq.read_table(out / ROWS).to_pylist()
    return sorted(rows, key=lambda row: (row["session"], row["channel"] or ""))


@pytest.mark.long
def test_command_resumes_and_lists_failures(sessions: Path, tmp_path: Path, client: Any) -> None:
    out, scheduler = tmp_path / "out", client.scheduler.address
    options = ("--out", out, "--scheduler", scheduler, "--timeout", 600)
    first = answer("batch", "decode", sessions / "s00", sessions / "s05", *options)
    assert (first["sessions"], first["done_before"]) == (2, 0)
    assert list(first["failed"]) == [str(sessions / "s05")]
    before = table(out)
    done = imumon("batch", "decode", sessions, *options)
    assert done.returncode == 0
    assert "12, 2 of them done before" in done.stderr
    assert "2 bad data" in done.stderr
    found = table(out)
    assert [row for row in found if row in before] == before
    assert len({(row["session"], row["channel"]) for row in found}) == len(found)
    assert {row["session"] for row in found} == {str(sessions / f"s{n:02}") for n in range(12)}
    shutil.copy(sessions / "s00" / "wire.mcap", sessions / "s05")
    again = answer("batch", "decode", sessions, *options, "--retry")
    assert list(again["failed"]) == [str(sessions / "s07")]
    assert len(table(out)) == len(found) - 1 + len(first_channels(found))


@pytest.mark.long
def test_what_a_scheduler_lost_is_no_failure_and_is_done_by_the_same_command(
    sessions: Path, tmp_path: Path, client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    out, good, add = tmp_path / "out", [sessions / f"s{n:02}" for n in range(5)], Dataset.add
    with (
        dask("scheduler", "--host", address, "--no-dashboard") as scheduler,
        dask("worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"),
    ):

        def killing(self: Dataset, rows: Any) -> None:
            add(self, rows)
            scheduler.kill()
            scheduler.wait()

        assert wait_until(lambda: answers(address))
        with monkeypatch.context() as patch:
            patch.setattr(Dataset, "add", killing)
            broken = imumon("batch", "decode", *good, "--out", out, "--scheduler", address)
    assert broken.returncode == 3
    assert "imumon: lost: the scheduler has lost the tasks" in broken.stderr
    assert "the same command does the rest" in broken.stderr
    rows = table(out)
    assert {row["session"] for row in rows} < set(map(str, good))
    assert {row["reason"] for row in rows} == {None}
    again = answer("batch", "decode", *good, "--out", out, "--scheduler", client.scheduler.address)
    assert (again["sessions"], again["done_before"], again["failed"]) == (5, 1, {})


@contextmanager
def dask(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program of Dask."""
    with subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def answers(address: str) -> bool:
    """Return whether a scheduler is there, with a worker."""
    try:
        with workers(address, 1) as found:
            return bool(found.nthreads())
    except ImumonError:
        return False


@pytest.mark.long
def test_ctrl_c_on_a_terminal_states_in_one_line_how_to_go_on(tmp_path: Path) -> None:
    lab = tmp_path / "lab"
    first = tiny(lab / "s000", seconds=30.0)
    for number in range(1, 400):
        (lab / f"s{number:03}").mkdir()
        shutil.copy(first / "session.yaml", lab / f"s{number:03}")
        (lab / f"s{number:03}" / "wire.mcap").symlink_to(first / "wire.mcap")
    command = [IMUMON, "batch", "replay", str(lab), "--out", str(tmp_path / "out"), "--workers", "1"]
    with subprocess.Popen(
        [sys.executable, "-c", TERMINAL, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        shown = ""
        while not re.search(r"[1-9]\d?%", shown):
            data = process.stdout.read(1 << 16)
            assert data, shown
            shown += data.decode(errors="replace")
        process.stdin.write(b"\x03")
        shown += process.stdout.read().decode(errors="replace")
    assert process.returncode == 130
    text = re.sub(r"\x1b\[[?0-9;]*[A-Za-z]", "", shown)
    lines = [line.strip() for line in re.split(r"[\r\n]+", text) if line.strip()]
    (said,) = (line for line in lines if not re.match(r"(\^C)?sessions ", line))
    done = re.fullmatch(
        r"imumon: interrupted: (\d+) of 400 sessions are done; the same command does the rest", said
    )
    assert done is not None, said
    assert len({row["session"] for row in table(tmp_path / "out")}) == int(done[1]) > 0


TERMINAL = """
import os, pty, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)  # background jobs of a shell ignore it
sys.exit(os.waitstatus_to_exitcode(pty.spawn(sys.argv[1:])))
"""


def test_more_failures_than_a_screen_takes_are_all_in_a_file(tmp_path: Path, client: Any) -> None:
    for number in range(25):
        (tmp_path / "lab" / f"s{number:02}").mkdir(parents=True)
        (tmp_path / "lab" / f"s{number:02}" / "session.yaml").write_text("format: nothing of ours\n")
    out, every = tmp_path / "out", tmp_path / "lab"
    options = ("--out", out, "--scheduler", client.scheduler.address)
    few = imumon("batch", "decode", *sorted(every.iterdir())[:13], *options)
    assert all(f"{every}/s{number:02}: bad data" in few.stderr for number in range(13))
    assert not (out / "failed.txt").exists()
    many = imumon("batch", "decode", every, *options)
    assert many.returncode == 1
    assert f"5 more failed; all 25 are in {out}/failed.txt" in many.stderr
    lines = (out / "failed.txt").read_text().splitlines()
    assert [line.partition(":")[0] for line in lines] == [f"{every}/s{number:02}" for number in range(25)]


def test_a_session_that_was_being_recorded_is_done_again_when_it_has_ended(
    tmp_path: Path, client: Any
) -> None:
    options = ("--out", tmp_path / "out", "--scheduler", client.scheduler.address)
    session = tiny(tmp_path / "s", seconds=2.0)
    whole = {path: path.read_bytes() for path in (session / "session.yaml", session / "wire.mcap")}
    (session / "session.yaml").write_bytes(whole[session / "session.yaml"].replace(b"closed", b"open"))
    (session / "wire.mcap").write_bytes(whole[session / "wire.mcap"][:20_000])
    assert answer("batch", "decode", session, *options)["lacking"]
    (before, *_) = table(tmp_path / "out")
    for path, content in whole.items():
        path.write_bytes(content)
    assert not answer("batch", "decode", session, *options)["lacking"]
    assert answer("batch", "decode", session, *options)["done_before"] == 1
    (after, *_) = table(tmp_path / "out")
    assert after["samples"] == 200 > before["samples"]
    assert len(table(tmp_path / "out")) == len({row["channel"] for row in table(tmp_path / "out")})


def test_what_is_not_in_this_call_keeps_its_failure(sessions: Path, tmp_path: Path, client: Any) -> None:
    options = ("--out", tmp_path / "out", "--scheduler", client.scheduler.address)
    imumon("batch", "decode", sessions / "s05", sessions / "s07", *options)
    imumon("batch", "decode", sessions / "s07", *options, "--retry")
    assert {row["session"] for row in table(tmp_path / "out")} == {
        str(sessions / name) for name in ("s05", "s07")
    }


def test_half_a_place_is_refused_before_anything_begins(sessions: Path, tmp_path: Path) -> None:
    done = imumon("batch", "calibrate", sessions, "--out", tmp_path / "out", "--heading", "10")
    assert done.returncode == 2
    assert "there is no latitude" in done.stderr
    assert not (tmp_path / "out").exists()


def first_channels(rows: list[Row]) -> list[Row]:
    return [row for row in rows if row["session"].endswith("s00")]


@pytest.mark.long
def test_nothing_is_lost_or_doubled_when_a_worker_dies_with_results_not_yet_fetched(
    sessions: Path, tmp_path: Path
) -> None:
    jobs = [Job(str(sessions / "s00"), DECODE, str(tmp_path), version=f"{n}") for n in range(12)]
    taken: list[Row] = []
    with workers(None, 1) as client:

        def statuses() -> list[str]:
            return [state.status for state in client.futures.values()]

        def take(rows: Any) -> None:
            taken.extend(rows)
            if len(taken) == 1:
                assert wait_until(lambda: set(statuses()) == {"finished"})
                (process,) = client.run(os.getpid).values()
                os.kill(process, signal.SIGKILL)
                assert wait_until(lambda: "lost" in statuses())

        run_jobs(client, jobs, take)
    assert sorted(row["error"].rpartition(" ")[2] for row in taken) == sorted(str(n) for n in range(12))


def test_a_session_that_kills_its_workers_is_a_failure(
    tmp_path: Path, client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "work", _deadly)
    deadly = Job(str(tmp_path), DECODE, str(tmp_path))
    good = Job(str(tiny(tmp_path / "good")), DECODE, str(tmp_path))
    taken: list[Row] = []
    run_jobs(client, [good], taken.extend)
    assert {row["session"] for row in taken} == {good.place}
    taken.clear()
    run_jobs(client, [deadly], taken.extend)
    assert [row["reason"] for row in taken] == ["worker died"]


def _deadly(job: Job) -> list[Row]:
    if job.place.endswith("good"):
        return work(job)
    os.kill(os.getpid(), signal.SIGKILL)
    return []


@pytest.mark.long
def test_a_defect_ends_no_batch(tmp_path: Path, client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "work", _defect)
    taken: list[Row] = []
    run_jobs(client, [Job("a", DECODE, str(tmp_path))] * 2, taken.extend)
    assert [row["reason"] for row in taken] == ["defect"] * 2
    assert taken[0]["error"] == "ZeroDivisionError: of a test"


@pytest.mark.long
def test_a_session_that_hangs_has_failed_and_the_others_are_done(tmp_path: Path, client: Any) -> None:
    good, taken = Job(str(tiny(tmp_path / "good")), DECODE, str(tmp_path), limit_s=600.0), list[Row]()
    with socket.create_server(("127.0.0.1", 0)) as silent:  # a server that never says a word
        url = f"ftp://127.0.0.1:{silent.getsockname()[1]}/one"
        run_jobs(client, [Job(url, DECODE, str(tmp_path), limit_s=5.0), good], taken.extend)
    (late,) = (row for row in taken if "reason" in row)
    assert (late["session"], late["reason"]) == (url, "timeout")
    assert late["error"] == "was not done after its --timeout"
    assert {row["session"] for row in taken} == {url, good.place}
    assert not [*(tmp_path / "late").iterdir()]


@pytest.mark.long
def test_code_that_never_lets_go_of_the_interpreter_is_ended_too(tmp_path: Path) -> None:
    script = (
        "import re, sys, pathlib\nfrom imumon.fleet.batch.tasks import limited\n"
        "with limited(pathlib.Path(sys.argv[1]), 1.0):\n    re.match('(a+)+$', 'a' * 60 + 'b')\n"
    )
    done = subprocess.run([sys.executable, "-c", script, tmp_path / "note"], timeout=LIMIT_S, check=False)
    assert done.returncode == 1
    with (
        pytest.raises(ImumonError, match="not done after its --timeout") as error,
        limited(tmp_path / "note", 1.0),
    ):
        pass
    assert error.value.reason is Reason.TIMEOUT
    with limited(tmp_path / "note", 60.0):  # the note counts once, and what ends in time leaves none
        pass
    assert not (tmp_path / "note").exists()


def test_a_worker_that_died_of_something_else_leaves_no_timeout(tmp_path: Path) -> None:
    (tmp_path / "note").touch()
    with limited(tmp_path / "note", 60.0):
        pass
    assert not (tmp_path / "note").exists()


def _defect(_: Job) -> list[Row]:
    raise ZeroDivisionError("of a test")


def test_nobody_at_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.fleet.batch.running.CONNECT_S", 1.0)
    with pytest.raises(ImumonError) as caught, workers("tcp://127.0.0.1:1", 1):
        pass
    assert caught.value.reason is Reason.NOT_FOUND


@pytest.mark.parametrize("command", ["replay", "allan", "calibrate", "diagnose"])
def test_every_command_has_rows_or_a_reason(command: Any, tmp_path: Path) -> None:
    session = tiny(tmp_path / "s", seconds=30.0)
    rows = work(Job(str(session), BatchOptions(command=command), str(tmp_path)))
    if command in ("replay", "allan"):
        assert {row["channel"] for row in rows} > {"gyro_x", "accel_z"}
        assert all(row["device"] == "ax1" for row in rows)
    else:
        assert [row["reason"] for row in rows] == ["bad data"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "rate_hz", "seconds"), [("calibrate", 1.0, 1500.0), ("diagnose", 2.0, 2400.0)]
)
def test_a_long_session_has_rows_of_every_channel_that_the_table_takes(
    command: Any, rate_hz: float, seconds: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few_steps(monkeypatch)
    session = tiny(tmp_path / "long", seconds=seconds, scenario="self-heating", rate_hz=rate_hz)
    rows = work(Job(str(session), BatchOptions(command=command), str(tmp_path)))
    units = {row["channel"]: row["unit"] for row in rows}
    assert units.keys() > {"gyro_x", "accel_z"}
    assert units["gyro_x"] == "rad/s"
    assert units.get("clock") == ("ppm" if command == "diagnose" else None)
    assert all(Path(row["file"]).is_file() for row in rows)
    table = pa.Table.from_pylist(rows, schema_of(command))
    assert set(rows[0]) <= set(table.column_names)
    results = table.select(list(RESULTS[command])).to_pylist()
    assert all(value is not None for row in results for value in row.values())
