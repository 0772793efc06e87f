from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pyarrow.fs import LocalFileSystem, S3FileSystem, copy_files

from imumon.errors import ImumonError
from imumon.fleet.batch.dataset import BatchOptions
from imumon.fleet.batch.places import fetched, find
from imumon.fleet.batch.tasks import Job, work
from tests.fleet.batch.sessions import tiny
from tests.waiting import LIMIT_S

SERVER = Path(sys.prefix, "s3", "bin", "moto_server")


def test_a_folder_gives_the_sessions_below(tmp_path: Path) -> None:
    for name in ("b", "a/deep"):
        tiny(tmp_path / name)
    assert find(str(tmp_path)) == [str(tmp_path / "a/deep"), str(tmp_path / "b")]
    assert find(str(tmp_path / "b")) == [str(tmp_path / "b")]
    with pytest.raises(ImumonError, match="there is no session"):
        find(str(tmp_path / "a/deep/none"))


def test_a_url_is_read_as_the_folder_is(tmp_path: Path) -> None:
    session = tiny(tmp_path / "sessions/one")
    found = find(f"file://{tmp_path}/sessions")
    assert found == [f"file://{session}"]
    options = BatchOptions(command="decode")
    here, there = (work(Job(place, options, str(tmp_path))) for place in (str(session), *found))
    assert [{**row, "session": ""} for row in here] == [{**row, "session": ""} for row in there]
    with fetched(found[0]) as copy:
        assert sorted(path.name for path in copy.iterdir()) == ["session.yaml", "wire.mcap"]
    assert not copy.exists()


def test_what_is_not_there_is_a_failure_with_its_reason(tmp_path: Path) -> None:
    (row,) = work(Job(f"file://{tmp_path}/none", BatchOptions(command="decode"), str(tmp_path)))
    assert row["reason"] == "bad data"
    assert "cannot be read" in row["error"]


def test_a_disk_that_fails_is_a_failure_of_the_session_and_no_defect(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    (row,) = work(Job(str(tiny(tmp_path / "s")), BatchOptions(command="decode", tables=True), str(gone)))
    assert (row["reason"], row["device"]) == ("system", "ax1")
    assert row["error"] == f"{gone}/tables: No such file or directory"


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A server that speaks S3, with sessions in a bucket."""
    if not SERVER.exists():
        pytest.skip(f"there is no {SERVER}: scripts/environment dev makes it")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    for name in ("one", "two"):
        tiny(tmp_path / "unit7" / name)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "anyone")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "anything")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
    server = subprocess.Popen(
        [SERVER, "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
    )
    try:
        end = time.monotonic() + LIMIT_S
        while time.monotonic() < end:
            with socket.socket() as asking:
                if not asking.connect_ex(("127.0.0.1", port)):
                    break
            time.sleep(0.1)
        here = {"endpoint_override": f"127.0.0.1:{port}", "scheme": "http", "region": "us-east-1"}
        files = S3FileSystem(**here, allow_bucket_creation=True)
        files.create_dir("lab")
        copy_files(
            str(tmp_path / "unit7"),
            "lab/unit7",
            source_filesystem=LocalFileSystem(),
            destination_filesystem=files,
        )
        yield "s3://lab/unit7"
    finally:
        server.terminate()
        server.wait()


@pytest.mark.long
def test_sessions_in_a_bucket(bucket: str, tmp_path: Path) -> None:
    found = find(f"{bucket}?region=us-east-1")
    assert found == [f"{bucket}/{name}?region=us-east-1" for name in ("one", "two")]
    options = BatchOptions(command="decode", tables=True)
    rows = work(Job(found[0], options, str(tmp_path)))
    assert {row["channel"] for row in rows} > {"gyro_x", "accel_z"}
    assert all("reason" not in row for row in rows)
    assert Path(rows[0]["file"]).is_file()
    with pytest.raises(ImumonError, match=r"s3://nobody/here\?\S*: cannot be read"):
        find("s3://nobody/here?region=us-east-1")
    (missing,) = work(Job(f"{bucket}/three?region=us-east-1", options, str(tmp_path)))
    assert missing["reason"] == "bad data"
