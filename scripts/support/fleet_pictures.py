"""Make pictures of docs/rack.md, docs/catalog.md, docs/magnetometer.md, of what tests simulate.

python -m support.fleet_pictures [rack] [record] [magnetometer]
"""

import os
import signal
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import rerun as rr

from imumon.cli import run
from imumon.fleet.rack.description import load_rack
from imumon.fleet.rack.rack import Rack
from imumon.fleet.rack.view import UnitsLogger
from imumon.lab.calibration.magnetometer import fit_magnetometer
from imumon.lab.calibration.plot import write_magnetometer_plot
from imumon.protocols.device import device_text, load_device
from imumon.view.items import ViewItem, ViewSetup
from imumon.view.viewer import APPLICATION
from support.screenshots import PICTURES, keep_small, studio
from tests.faults.rack import Feeder, packets, write_rack
from tests.fleet.catalog.fleet import RUNAWAY, fleet
from tests.lab.calibration.test_magnetometer import figure_eight

FIGURES = PICTURES.parent / "figures"
RATE_HZ = 100.0
UNITS, SECONDS = 8, 90.0
SCENARIO = "night"
"""At rest, so that every unit has a bias."""
DEAD_FOR_S, JUNK_FOR_S = 1.5, 6.0
"""Before the picture of the page a process is killed, and the port of another brings junk."""


def record(folder: Path) -> None:
    """Take the chart of the drift out of the record of a unit, of a fleet that the tests make."""
    sessions, page = fleet(folder / "fleet"), folder / "record.html"
    assert not run(["report", RUNAWAY, "--sessions", str(sessions), "--out", str(page)])
    _, _, drift = page.read_text().partition('id="drift"')
    chart = drift[drift.index("<svg") : drift.index("</svg>") + len("</svg>")]
    (PICTURES / "record.svg").write_text(chart + "\n")


def magnetometer(_: Path) -> None:
    """Draw what `imumon magnetometer --plot` draws of a figure-eight."""
    fit = fit_magnetometer([figure_eight(1)[0]], "uT", "simulated")
    write_magnetometer_plot(FIGURES / "magnetometer.png", fit, "simulated figure-eight")


def rack(folder: Path) -> None:
    """Let a rack run, and photograph it."""
    names = [f"unit-{number:02d}" for number in range(1, UNITS + 1)]
    device = folder / "fast.yaml"
    text = device_text("ax1")[0].replace("name: ax1", "name: fast")
    device.write_text(text.replace("baudrates: [115200", "baudrates: [921600"))
    sent = packets(load_device(str(device)), RATE_HZ, SECONDS + 60.0, SCENARIO)
    items: list[ViewItem] = []
    running = Rack(folder / "sessions", print, items.append)
    with studio() as place, closing(Feeder(folder, names, sent, RATE_HZ)) as feeder:
        rec = rr.RecordingStream(APPLICATION, recording_id="rack")
        rec.set_sinks(rr.GrpcSink(place.url))
        logger = UnitsLogger(rec, ViewSetup("rack bench", "rack"))
        logger.begin()
        running.change(load_rack(write_rack(folder, feeder, device.name)))
        try:
            while not feeder.is_open():
                running.look()
                time.sleep(0.1)
            feeder.start()
            killed, began_s = False, time.monotonic()
            while (passed_s := time.monotonic() - began_s) < SECONDS:
                running.look()
                logger.log(items)
                items.clear()
                time.sleep(0.2)
                if passed_s > SECONDS - JUNK_FOR_S:
                    feeder.flooding.add(names[2])
                if passed_s > SECONDS - DEAD_FOR_S and not killed:
                    killed = True
                    os.kill(running.units[-2].process.pid, signal.SIGKILL)  # type: ignore[union-attr]
            arrangement = logger.arrangement
            assert arrangement is not None
            for tab, name in enumerate(("rack", "rack-unit")):
                arrangement.root_container.active_tab = tab
                rec.send_blueprint(arrangement)
                rec.flush()
                time.sleep(place.settle_s)
                place.viewer.save_screenshot(str(folder / f"{name}.png"))
                keep_small(folder / f"{name}.png", name)
        finally:
            running.stop()
        rec.disconnect()


if __name__ == "__main__":
    for chosen in (rack, record, magnetometer):
        if not sys.argv[1:] or chosen.__name__ in sys.argv[1:]:
            with tempfile.TemporaryDirectory(prefix="imumon-") as scratch:
                chosen(Path(scratch))
