"""Make docs/images/live-view.png: a virtual AHRS, a real live run, a real viewer without a screen."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from imumon.protocols.device import device_text, load_device
from imumon.run.live import LiveRun, warm_up
from imumon.run.narration import view_setup
from imumon.run.setup import Setup
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.settings import PortSettings
from imumon.view.publisher import ViewPublisher
from imumon.view.viewer import free_port, proxy_url, viewer_binary

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "live-view.png"
WINDOW_S = 20.0


def main() -> None:
    """Record for a while with the web view, and look at its stream."""
    device = load_device("ax1")
    with (
        tempfile.TemporaryDirectory(prefix="imumon-") as folder,
        VirtualDevice(device, Path(folder) / "ahrs") as ahrs,
    ):
        run = LiveRun(
            device, device_text("ax1")[0], PortSettings(ahrs.port.path), Setup(), Path(folder) / "bench", _say
        )
        run.open()
        live = ViewPublisher("web", view_setup(run.session, run.pipeline.units, WINDOW_S)).start()
        warm_up(device, Setup())
        run.begin([live.publish])
        time.sleep(10)
        _photograph(proxy_url(live.stream_port))
        run.stop()
        live.close()
    print(PICTURE)


def _photograph(url: str) -> None:
    viewer = ViewerClient.spawn(
        headless=True, port=free_port(9871), executable_path=str(viewer_binary()), hide_welcome_screen=True
    )
    viewer.open(url)
    time.sleep(12)
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    viewer.save_screenshot(str(PICTURE))
    viewer.quit()


def _say(level: str, text: str) -> None:
    print(level, text)


if __name__ == "__main__":
    main()
