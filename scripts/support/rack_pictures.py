"""Make the pictures of docs/rack.md, of a rack that records: python -m support.rack_pictures"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from contextlib import closing
from pathlib import Path

import rerun as rr
from PIL import Image

from imumon.fleet.rack.description import load_rack
from imumon.fleet.rack.rack import Rack
from imumon.fleet.rack.view import UnitsLogger
from imumon.protocols.device import device_text, load_device
from imumon.view.items import ViewItem, ViewSetup
from imumon.view.viewer import APPLICATION
from support.screenshots import COLORS, PICTURES, studio
from tests.faults.rack import Feeder, packets, write_rack

RATE_HZ = 400.0
UNITS, SECONDS = 16, 90.0
DEAD_FOR_S = 1.5
"""Before the picture of the page a process is killed."""


def main() -> None:
    """Let a rack run, and photograph it."""
    names = [f"unit-{number:02d}" for number in range(1, UNITS + 1)]
    with tempfile.TemporaryDirectory(prefix="imumon-") as scratch, studio() as place:
        folder = Path(scratch)
        device = folder / "fast.yaml"
        text = device_text("ax1")[0].replace("name: ax1", "name: fast")
        device.write_text(text.replace("baudrates: [115200", "baudrates: [921600"))
        sent = packets(load_device(str(device)), RATE_HZ, SECONDS + 60.0)
        rec = rr.RecordingStream(APPLICATION, recording_id="rack")
        rec.set_sinks(rr.GrpcSink(place.url))
        logger = UnitsLogger(rec, ViewSetup("rack bench", "rack"))
        logger.begin()
        items: list[ViewItem] = []
        rack = Rack(folder / "sessions", print, items.append)
        with closing(Feeder(folder, names, sent, RATE_HZ)) as feeder:
            rack.change(load_rack(write_rack(folder, feeder, device.name)))
            try:
                while not feeder.is_open():
                    rack.look()
                    time.sleep(0.1)
                feeder.start()
                killed, began_s = False, time.monotonic()
                while (passed_s := time.monotonic() - began_s) < SECONDS:
                    rack.look()
                    logger.log(items)
                    items.clear()
                    time.sleep(0.2)
                    if passed_s > SECONDS - DEAD_FOR_S and not killed:
                        killed = True
                        os.kill(rack.units[-2].process.pid, signal.SIGKILL)  # type: ignore[union-attr]
                arrangement = logger.arrangement
                assert arrangement is not None
                for tab, name in enumerate(("rack", "rack-unit")):
                    arrangement.root_container.active_tab = tab
                    rec.send_blueprint(arrangement)
                    rec.flush()
                    time.sleep(place.settle_s)
                    picture = folder / f"{name}.png"
                    place.viewer.save_screenshot(str(picture))
                    small = Image.open(picture).convert("RGB").quantize(COLORS)
                    small.save(PICTURES / picture.name, optimize=True)
            finally:
                rack.stop()
        rec.disconnect()


if __name__ == "__main__":
    main()
