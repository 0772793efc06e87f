"""A live run at 1 kHz: processor time of the whole program, and how old what the viewer shows is."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import psutil
from rerun.experimental import ViewerClient
from study import Cells, Table
from support.scenes import at_baud
from support.screenshots import studio

from benchmarks.measure import Bar, Result
from imumon.protocols.device import load_device
from imumon.simulation.virtual_device import VirtualDevice
from imumon.view.viewer import VIEWER_PORT, probe

DEVICE, BAUDRATE = "ax1", 921_600
RATES_HZ = (100.0, 1000.0)
STARTING_S, SETTLING_S, MEASURED_S = 30.0, 8.0, 20.0
MOST_OF_A_CORE, OLDEST_S = 0.25, 0.150


def live() -> Result:
    """Record a virtual AHRS with the native view, on a viewer without a screen."""
    if probe(VIEWER_PORT) is not None:
        sys.exit(f"port {VIEWER_PORT} is in use: close the viewer that is open")
    rows: list[Cells] = []
    bars: list[Bar] = []
    for rate in RATES_HZ:
        monitor, view, viewer, ages_s = _measured(rate)
        both, (middle, oldest) = monitor + view, np.quantile(ages_s, (0.5, 0.99))
        load = os.getloadavg()[0]
        rows.append([f"{rate:g} Hz", monitor, view, both, viewer, 1e3 * middle, 1e3 * oldest, load])
        if rate == max(RATES_HZ):
            bars.append(Bar(f"live at {rate:g} Hz, share of a core", MOST_OF_A_CORE, both, at_most=True))
            bars.append(Bar(f"live at {rate:g} Hz, age p99, s", OLDEST_S, float(oldest), at_most=True))
    note = (
        f"{MEASURED_S:g} s, after {SETTLING_S:g} s; the virtual device and the viewer, drawing by software, "
        f"have the {os.cpu_count()} cores, too, and do not count.\n\n"
        "age: of the newest sample that the viewer has since its arrival, ms, read about 50 times a second"
    )
    heads = ["rate", "monitor", "view process", "both, of a core", "viewer"]
    heads += ["age p50", "age p99", "load of the machine"]
    formats = ("", ".1%", ".1%", ".1%", ".1%", ".0f", ".0f", ".1f")
    return [Table("## Live run with the native view", heads, rows, note, formats)], bars


def _measured(rate_hz: float) -> tuple[float, float, float, list[float]]:
    """Return shares of a core of monitor, view process and viewer, and ages of the newest sample, s."""
    fast = at_baud(load_device(DEVICE), BAUDRATE)
    with (
        TemporaryDirectory(prefix="imumon-") as folder,
        studio(port=VIEWER_PORT) as place,
        VirtualDevice(fast, Path(folder) / "ahrs", rate_hz) as ahrs,
        _monitor(ahrs.port.path, Path(folder)) as monitor,
    ):
        viewer = place.viewer
        _wait_for(viewer, monitor)
        time.sleep(SETTLING_S)
        measuring = psutil.Process(monitor.pid)
        drawing = next(one for one in psutil.Process().children() if one.name().startswith("rerun"))
        processes = [drawing, measuring, *measuring.children(recursive=True)]
        before, began = [_cpu_s(one) for one in processes], time.monotonic()
        ages = []
        while (spent := time.monotonic() - began) < MEASURED_S:
            ages.append((time.time_ns() - _newest_ns(viewer)) * 1e-9)
            time.sleep(0.02)
        shares = [(_cpu_s(one) - at) / spent for one, at in zip(processes, before, strict=True)]
    return shares[1], sum(shares[2:]), shares[0], ages


@contextmanager
def _monitor(port: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Monitor a port; its log and the recording go to a folder."""
    program = [sys.executable, "-c", "from imumon.cli import main; main()", "monitor", port]
    options = f"--device {DEVICE} --baud {BAUDRATE} --view native --out {folder}/session"
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([*program, *options.split()], stdout=subprocess.DEVNULL, stderr=log)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(STARTING_S)


def _wait_for(viewer: ViewerClient, monitor: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + STARTING_S
    while _newest_ns(viewer) == 0:
        if monitor.poll() is not None or time.monotonic() > deadline:
            sys.exit("the monitor shows nothing")
        time.sleep(0.2)


def _newest_ns(viewer: ViewerClient) -> int:
    lines = [line for recording in viewer.get_state().recordings for line in recording.timelines]
    ends = (line.end for line in lines if line.name == "host_time")
    return max((int(end) for end in ends if end is not None), default=0)


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)
