from __future__ import annotations

import http.client
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from PIL import Image
from rerun.experimental import ViewerClient

from imumon.charts import AXIS_COLORS
from imumon.view.fed import QUEUE_BYTES
from imumon.view.items import Timebase, ViewSetup
from imumon.view.publisher import ViewPublisher
from imumon.view.viewer import (
    Mode,
    free_port,
    probe,
    proxy_url,
    quiet_environment,
    start_viewer,
    viewer_binary,
)
from tests.view.conftest import StartViewer
from tests.view.streams import ACCEL, DEVICE_NS, RATE_HZ, Stream, block, scalars
from tests.waiting import LIMIT_S, wait_until

Publish = Callable[[Mode, int], ViewPublisher]


@pytest.fixture
def publish(monkeypatch: pytest.MonkeyPatch) -> Iterator[Publish]:
    """Start publishers on a machine without a display; all are closed in the end."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    started: list[ViewPublisher] = []

    def start(mode: Mode, port: int) -> ViewPublisher:
        monkeypatch.setenv("IMUMON_TEST_PORT", str(port))  # marks every process that comes of it
        publisher = ViewPublisher(mode, ViewSetup("synthetic AHRS", "live-1"), port=port + (mode == "web"))
        started.append(publisher)
        return publisher.start()

    yield start
    for publisher in started:
        publisher.close()


def child() -> psutil.Process:
    """Return the view process."""
    processes = [
        process
        for process in psutil.Process().children()
        if process.status() != psutil.STATUS_ZOMBIE and "imumon.view.child" in process.cmdline()
    ]
    (process,) = processes
    return process


def seen(port: int) -> dict[str, tuple[int, int]]:
    """Return start and end of the timelines that the viewer shows; empty before it shows any."""
    with ViewerClient.connect(f"rerun+http://127.0.0.1:{port}") as client:
        recordings = client.get_state().recordings
    lines = [line for recording in recordings for line in recording.timelines]
    return {
        line.name: (line.start, line.end) for line in lines if line.start is not None and line.end is not None
    }


def views(port: int) -> dict[str, Any]:
    """Return the views that the viewer shows, by their names."""
    with ViewerClient.connect(f"rerun+http://127.0.0.1:{port}") as client:
        return {view.name: view for view in client.get_state().views}


def stream_of() -> str:
    """Return where the view process serves its stream: at an address that no page of another site knows."""
    listening = [one.laddr for one in child().net_connections() if one.status == psutil.CONN_LISTEN]
    (address,) = [one for one in listening if one.ip != "127.0.0.1"]
    return proxy_url(address.port, address.ip)


@contextmanager
def closing_process(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """End a process at last."""
    try:
        yield
    finally:
        process.kill()
        process.wait()


def colours_in(image: Path, colours: tuple[tuple[int, int, int], ...]) -> list[int]:
    """Return how many pixels of the image have each colour, nearly."""
    pixels = np.asarray(Image.open(image).convert("RGB")).astype(int)
    return [int((np.abs(pixels - np.array(colour)).max(axis=2) < 12).sum()) for colour in colours]


@pytest.mark.long
@pytest.mark.viewer
def test_viewer_shows_the_stream(publish: Publish, headless: StartViewer, port: int, tmp_path: Path) -> None:
    headless(port)
    publisher = publish("native", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: bool(publisher.url), "serving")
    stream.run_until(lambda: "device_time" in seen(port), "samples seen")
    before = seen(port)
    stream.run_until(lambda: seen(port)["sample"][1] > before["sample"][1], "it goes on")
    after = seen(port)
    assert {"sample", "device_time", "host_time"} <= after.keys()
    assert after["sample"][0] == 0
    names = {
        "Angular rate [°/s]: x red, y green, z blue",
        "Specific force [m/s²]: x red, y green, z blue",
        "Magnetic field [µT]: x red, y green, z blue",
        "Status",
        "States",
        "Log",
    }
    stream.run_until(lambda: names <= views(port).keys(), "all views are there")
    assert [report for view in views(port).values() for report in view.reports] == []

    def is_drawn() -> bool:
        """Return whether all axes are in a picture of the strip; a new arrangement gives it another view."""
        picture = tmp_path / "gyro.png"
        gyro = views(port).get("Angular rate [°/s]: x red, y green, z blue")
        if gyro is None:
            return False
        with ViewerClient.connect(f"rerun+http://127.0.0.1:{port}") as client:
            client.save_screenshot(str(picture), view_id=gyro.view_id)
        return min(colours_in(picture, tuple(AXIS_COLORS.values()))) > 10

    stream.run_until(is_drawn, "the rates are drawn")


@pytest.mark.long
@pytest.mark.viewer
def test_a_viewer_that_comes_later_sees_all_from_the_start(
    publish: Publish, headless: StartViewer, port: int
) -> None:
    first = headless(port)
    publisher = publish("native", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: "sample" in seen(port), "samples seen")
    first.kill()
    first.wait()
    later = free_port(port + 10)
    with closing_process(start_viewer(later, publisher.url, "--headless")):
        stream.run_until(lambda: probe(later) is True, "the viewer is there")
        stream.run_until(lambda: seen(later).get("sample", (1, 0))[0] == 0, "what was before is shown")
        stream.run_until(lambda: "Log" in views(later), "as it is arranged")
        end = seen(later)["sample"][1]
        stream.run_until(lambda: seen(later)["sample"][1] > end, "it goes on")
    assert (publisher.restarts, publisher.dropped) == (0, 0)


@pytest.mark.long
@pytest.mark.viewer
def test_an_open_viewer_goes_on_with_a_view_process_that_is_started_again(
    publish: Publish, headless: StartViewer, port: int
) -> None:
    headless(port)
    publisher = publish("native", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: "sample" in seen(port), "samples seen")
    stream.run_until(lambda: publisher.text == "viewer open", "it is known to be open")
    child().kill()
    stream.run_until(lambda: publisher.restarts == 1 and bool(publisher.url), "it is back")
    sent = stream.sent
    stream.run_until(lambda: seen(port)["sample"][1] > sent, "samples of the second process are seen")
    assert publisher.text == "viewer open"


@pytest.mark.viewer
def test_stopped_viewer_costs_little_and_gets_what_it_missed(
    publish: Publish, headless: StartViewer, port: int
) -> None:
    viewer = headless(port)
    publisher = publish("native", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: "sample" in seen(port), "samples seen")
    viewer.send_signal(signal.SIGSTOP)
    for _ in range(200):
        stream.send(50)
    assert publisher.dropped == 0
    viewer.send_signal(signal.SIGCONT)
    stream.run_until(lambda: seen(port)["sample"][1] >= 10_000, "what was missed is shown")
    viewer.send_signal(signal.SIGSTOP)
    started = time.monotonic()
    publisher.close()
    assert time.monotonic() - started < LIMIT_S


@pytest.mark.long
@pytest.mark.viewer
def test_what_was_sent_last_is_shown_before_the_view_ends(
    publish: Publish, headless: StartViewer, port: int
) -> None:
    headless(port)
    publisher = publish("native", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: "sample" in seen(port), "samples seen")
    for _ in range(20):
        stream.send(200)
    publisher.close(LIMIT_S)
    assert wait_until(lambda: seen(port)["sample"][1] == stream.sent - 1), (seen(port), stream.sent)


@pytest.mark.long
@pytest.mark.parametrize("mode", ["native", "web"])
def test_second_reader_gets_exact_samples_from_the_stream(
    publish: Publish, port: int, tmp_path: Path, mode: Mode
) -> None:
    publisher = publish(mode, port)
    path = tmp_path / "captured.rrd"
    stream = Stream(publisher.publish)
    stream.run_until(lambda: bool(publisher.url), "connected")
    command = [str(viewer_binary()), stream_of(), "--save", str(path), "--port=auto", "--bind=127.0.0.1"]
    reader = subprocess.Popen(
        command, env=quiet_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    with closing_process(reader):
        stream.run_until(lambda: path.exists() and path.stat().st_size > 1_000_000, "captured")
    whole = path.with_name("whole.rrd")  # the reader was stopped anywhere, maybe within a message
    repair = [str(viewer_binary()), "rrd", "optimize", str(path), "-o", str(whole)]
    subprocess.run(repair, env=quiet_environment(), check=True, capture_output=True)
    sample, device, _, accel = scalars([whole], "/samples/accel")
    assert len(sample) >= 100
    np.testing.assert_array_equal(device - DEVICE_NS, sample * (1_000_000_000 // RATE_HZ))
    np.testing.assert_array_equal(accel, stream.column(ACCEL)[sample])


@pytest.mark.long
def test_killed_view_process_is_started_again_on_the_same_ports(publish: Publish, port: int) -> None:
    publisher = publish("web", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: bool(publisher.url), "serving")
    url = publisher.url
    child().kill()
    stream.run_until(lambda: publisher.restarts == 1, "noticed")
    stream.run_until(lambda: bool(publisher.url), "serving again")
    assert publisher.url == url


HERE = socket.gethostname()
ASKED = [
    ({}, 200),
    ({"Origin": "http://127.0.0.1:9090"}, 200),
    ({"Host": f"{HERE}:9090", "Origin": f"http://{HERE}:9090"}, 200),
    ({"Origin": "http://evil.example"}, 403),
    ({"Origin": "null"}, 403),
    ({"Host": "evil.example"}, 403),
    ({"Host": "evil.example", "Origin": "http://evil.example"}, 403),
]


def test_on_this_machine_only_and_by_no_other_web_site_the_stream_is_read(
    publish: Publish, port: int
) -> None:
    publisher = publish("web", port)
    Stream(publisher.publish).run_until(lambda: bool(publisher.url), "serving")
    listening = [one.laddr for one in child().net_connections() if one.status == psutil.CONN_LISTEN]
    assert all(address.ip.startswith("127.") for address in listening)
    port = publisher._report.port
    assert {address.port for address in listening if address.ip == "127.0.0.1"} == {port}
    path = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
    for headers, status in ASKED:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LIMIT_S)
        asked = {"Content-Type": "application/grpc-web+proto", "X-Grpc-Web": "1", **headers}
        connection.request("POST", path, bytes(5), asked)
        with closing(connection), connection.getresponse() as response:
            assert response.status == status
            shown = response.read1(1 << 16)
            while status == 200 and b"live-1" not in shown:
                shown += response.read1(1 << 16)
            assert (b"live-1" in shown) == (status == 200)


@pytest.mark.long
def test_without_any_viewer_publishing_goes_on_and_the_state_gives_the_reason(
    publish: Publish, port: int
) -> None:
    publisher = publish("native", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: "could not start" in publisher.text, "noticed")
    stream.run(0.5)
    assert publisher.dropped == 0
    started = time.monotonic()
    publisher.close()
    assert time.monotonic() - started < LIMIT_S


def test_stopped_view_process_costs_bounded_memory_and_does_not_block_exit(
    publish: Publish, port: int
) -> None:
    publisher = publish("web", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: bool(publisher.url), "serving")
    os.kill(child().pid, signal.SIGSTOP)
    large = Timebase().samples(block(0, 100_000))
    for _ in range(2 * QUEUE_BYTES // large.nbytes + 20):
        publisher.publish(large)
    stream.run_until(lambda: publisher.dropped > 0, "counted")
    started = time.monotonic()
    publisher.close()
    assert time.monotonic() - started < LIMIT_S


@pytest.mark.long
def test_view_process_that_takes_nothing_is_started_again(
    publish: Publish, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = publish("web", port)
    stream = Stream(publisher.publish)
    stream.run_until(lambda: bool(publisher.url), "serving")
    with monkeypatch.context() as impatient:  # on a busy machine it takes longer to start
        impatient.setattr("imumon.view.fed.STUCK_S", 1.0)
        os.kill(child().pid, signal.SIGSTOP)
        stream.send(20_000)  # more than a pipe holds
        stream.run_until(lambda: publisher.restarts >= 1, "noticed")
    stream.run_until(lambda: bool(publisher.url), "serving again")


@pytest.mark.parametrize("after_s", [0.0, 0.1, 0.2, 0.3, 0.4])
def test_close_at_any_time_leaves_no_process(publish: Publish, port: int, after_s: float) -> None:
    publisher = publish("web", port)
    time.sleep(after_s)
    publisher.close(timeout_s=0.5)
    assert wait_until(lambda: not programs_of(port)), programs_of(port)


def programs_of(port: int) -> list[list[str]]:
    """Return the command lines of view processes, and of programs that they started, that still run."""
    ours = []
    for process in psutil.process_iter(["cmdline", "environ", "status"]):
        alive = process.info["status"] != psutil.STATUS_ZOMBIE
        if (
            process.pid != os.getpid()
            and alive
            and (process.info["environ"] or {}).get("IMUMON_TEST_PORT") == str(port)
        ):
            ours.append(process.info["cmdline"])
    return ours
