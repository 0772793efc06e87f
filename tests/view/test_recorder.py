from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
import warnings
from pathlib import Path

import numpy as np
import psutil
import pytest
from rerun.chunk import RrdReader

from imumon.charts import RED, Axis, Chart, Curve
from imumon.view.items import Drawing, Instant, ViewSetup
from imumon.view.recorder import ViewRecorder
from imumon.view.viewer import quiet_environment, viewer_binary
from tests.view.streams import ACCEL, RATE_HZ, Stream, block, entities, scalars
from tests.waiting import LIMIT_S

SETUP = ViewSetup("test", "recording-1")


def rerun(*arguments: str) -> None:
    """Run the viewer's command line and fail when it does."""
    done = subprocess.run(
        [viewer_binary(), *arguments], env=quiet_environment(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()


def check_extremes(files: list[Path], stream: Stream) -> None:
    """Of every half second the least and greatest value of each axis must be there, exact, at their times."""
    sample, device, host, accel = scalars(files, "/samples/accel")
    sent = stream.column(ACCEL)
    np.testing.assert_array_equal(accel, sent[sample])
    times = block(0, stream.sent)
    np.testing.assert_array_equal(device, times["device_time_ns"][sample])
    np.testing.assert_array_equal(host, times["host_time_ns"][sample])
    step = times["device_time_ns"] // 500_000_000
    for number in np.unique(step):
        inside = sent[step == number]
        kept = accel[step[sample] == number]
        np.testing.assert_array_equal(kept.min(axis=0), inside.min(axis=0))
        np.testing.assert_array_equal(kept.max(axis=0), inside.max(axis=0))


def test_spikes_come_back_bit_for_bit_in_a_fraction_of_the_rows(tmp_path: Path) -> None:
    recorder = ViewRecorder(tmp_path / "view.rrd", SETUP)
    stream = Stream(recorder.publish)
    for _ in range(20):
        stream.send(25)
    recorder.close()
    assert recorder.files == [tmp_path / "view.rrd"]
    assert recorder.dropped == 0
    check_extremes(recorder.files, stream)
    assert "/view/gyro" in entities(recorder.files[0])
    assert "/samples/gyro" not in entities(recorder.files[0])  # the same in another unit
    assert len(scalars(recorder.files, "/samples/accel")[0]) <= 10 * 7
    rerun("rrd", "verify", str(tmp_path / "view.rrd"))


def test_segments_open_as_one_and_each_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.view.recorder.BATCH_S", 0.01)
    monkeypatch.setattr("imumon.view.recorder.SEGMENT_S", 0.35)
    recorder = ViewRecorder(tmp_path / "view.rrd", SETUP)
    stream = Stream(recorder.publish)
    while len(recorder.files) < 4:
        stream.send(9 * RATE_HZ)
        time.sleep(0.1)
    recorder.close()
    names = ["view.rrd", "view.0001.rrd", "view.0002.rrd", "view.0003.rrd"]
    assert [path.name for path in recorder.files][:4] == names
    check_extremes(recorder.files, stream)
    whole = tmp_path / "whole.rrd"
    rerun("rrd", "merge", *map(str, recorder.files), "-o", str(whole))
    (store,) = RrdReader(str(whole)).recordings()
    assert (store.application_id, store.recording_id) == ("imumon", "recording-1")
    check_extremes([whole], stream)
    for path in recorder.files:
        rerun("rrd", "verify", str(path))
        assert {"/1-Port", "/status", "/attitude/body/housing"} <= entities(path)
    assert RrdReader(str(recorder.files[0])).blueprints()


def test_what_cannot_be_drawn_is_reported_once_and_the_file_is_whole(tmp_path: Path) -> None:
    reports = list[str]()
    recorder = ViewRecorder(tmp_path / "view.rrd", SETUP, on_error=reports.append)
    stream = Stream(recorder.publish)
    stream.send(50)
    x = np.array([1.0, 2.0])
    curves = (Curve("c", x, x[:1], RED),)
    recorder.publish(Drawing(Instant(None, None, 5), Chart("k", "Mine", "t", Axis("x"), Axis("y"), curves)))
    recorder.close(LIMIT_S)
    assert reports == [recorder.error]
    assert "view.rrd cannot be written any more" in recorder.error
    assert "/samples/accel" in entities(tmp_path / "view.rrd")
    rerun("rrd", "verify", str(tmp_path / "view.rrd"))


def test_segments_cost_no_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.view.recorder.BATCH_S", 0.01)
    monkeypatch.setattr("imumon.view.recorder.SEGMENT_S", 0.0)
    recorder = ViewRecorder(tmp_path / "view.rrd", SETUP)
    stream = Stream(recorder.publish)
    while len(recorder.files) < 3:
        stream.send(10)
        time.sleep(0.01)
    threads = psutil.Process().num_threads()
    while len(recorder.files) < 23:
        stream.send(10)
        time.sleep(0.01)
    assert psutil.Process().num_threads() <= threads + 2
    recorder.close()


def test_killed_process_leaves_a_readable_file(tmp_path: Path) -> None:
    script = """
        import os, signal, sys, time
        from pathlib import Path
        from imumon.view.items import ViewSetup
        from imumon.view import recorder as rooms
        from imumon.view.recorder import ViewRecorder
        from tests.view.streams import Stream
        rooms.BATCH_S = 2.0
        path = Path(sys.argv[1])
        recorder = ViewRecorder(path, ViewSetup("test", "killed"))
        stream = Stream(recorder.publish)
        for _ in range(40):
            stream.send(50)
        size = path.stat().st_size
        while path.stat().st_size < size + 50_000:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    path = tmp_path / "view.rrd"
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script), str(path)], cwd=root, check=False)
    assert done.returncode == -signal.SIGKILL
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rerun says that the footer is missing, as it must be
        sample, *_ = scalars([path], "/samples/accel")
    assert sample[0] == 0
    assert sample[-1] >= 1900


def test_full_disk_is_reported_and_what_is_missing_counted(tmp_path: Path) -> None:
    script = """
        import resource, signal, sys, time
        from pathlib import Path
        from imumon.view.items import ViewSetup
        from imumon.view import recorder as rooms
        from imumon.view.recorder import ViewRecorder
        from tests.view.streams import Stream
        rooms.BATCH_S, rooms.FLUSH_S = 0.05, 5.0  # where only flushes that take too long show it
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000))
        said = []
        recorder = ViewRecorder(Path(sys.argv[1]), ViewSetup("test", "full"), on_error=said.append)
        stream = Stream(recorder.publish)
        while not recorder.error:
            stream.send(5000)
            time.sleep(0.1)
        before = recorder.dropped
        stream.send(500)
        recorder.close()
        assert said == [recorder.error]
        print(recorder.error, recorder.dropped - before)
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "view.rrd")]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True, timeout=LIMIT_S)
    assert "cannot be written any more" in done.stdout
    assert int(done.stdout.split()[-1]) >= 500
