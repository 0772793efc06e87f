"""Make the pictures of the docs, and check them: every tab of every scene, on a viewer without a screen."""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rerun as rr
from PIL import Image
from rerun.experimental import ViewerClient

from imumon.view.items import ViewItem, ViewSetup, merge
from imumon.view.logger import StreamLogger
from imumon.view.panels import PANELS
from imumon.view.viewer import APPLICATION, free_port, proxy_url, quiet_environment, viewer_binary
from imumon.view.window import slow_window
from support.picture_faults import axis_faults, is_empty, views_of
from support.scenes import scenes, view_items

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "images"
SHOWN = {
    "live-view": ("demo", "Live"),
    "temperature": ("slow", "Temperature"),
    "gyro-bias": ("recorded", "Gyro bias"),
    "residual": ("wrong", "Residual"),
    "learning": ("learning", "Residual"),
    "attitude": ("slow", "Attitude"),
    "spectrum": ("fast", "Spectrum"),
    "allan": ("isothermal", "Allan"),
    "alignment": ("alignment", "Alignment"),
}
"""The pictures that the docs have: of which scene, which tab."""
CROPS = {
    "gyro-bias": {"bias-curve": (1350, 480, 1920, 950)},
    "alignment": {"alignment-sigma": (1350, 480, 1920, 950)},
    "allan": {"allan-gyro": (0, 190, 960, 960)},
}
"""Parts of them that stand alone: name, and left, upper, right, lower pixel."""
HEADER = 37
"""Height of the viewer's menu bar, which warns of the machine that takes the pictures."""
COLORS = 128
"""Of a picture in the docs, which is then a quarter as large."""
DATA = Path(os.environ.get("IMUMON_DATA", ROOT / ".." / "shared" / "data"))
SETTLE_S = 4.0
"""What the viewer takes, without a GPU, to draw a tab that was not drawn before."""
TRIES = 4
"""So often an empty panel is looked at again before it is a fault."""
AT_ONCE = 100
"""Items that are logged together."""


@dataclass(slots=True)
class Studio:
    """A viewer without a screen."""

    viewer: ViewerClient
    url: str
    settle_s: float = SETTLE_S

    def photograph(
        self, setup: ViewSetup, items: Sequence[ViewItem], folder: Path, *, live: bool
    ) -> list[str]:
        """Show items and save a picture of every tab (`picture_name`); return what is wrong with them."""
        with tempfile.TemporaryDirectory(prefix="imumon-") as scratch:
            stream = Path(scratch) / "stream.rrd"
            rec = rr.RecordingStream(APPLICATION, recording_id=setup.recording_id)
            rec.set_sinks(rr.FileSink(stream), rr.GrpcSink(self.url))
            logger = StreamLogger(rec, setup, live=live)
            logger.begin()
            for first in range(0, len(items), AT_ONCE):
                logger.log(merge(items[first : first + AT_ONCE]))
            logger.finish()
            faults = self._tabs(rec, logger, setup.title, folder, Path(scratch))
            rec.disconnect()
            if live:
                faults += axis_faults(stream, PANELS, slow_window(setup.window_s))
        return [f"{setup.title}: {fault}" for fault in faults]

    def _tabs(
        self, rec: rr.RecordingStream, logger: StreamLogger, title: str, folder: Path, scratch: Path
    ) -> list[str]:
        arrangement, faults = logger.arrangement, list[str]()
        assert arrangement is not None, "nothing was logged"
        tabs = arrangement.root_container
        for number, tab in enumerate(tabs.contents):
            tabs.active_tab = number
            rec.send_blueprint(arrangement)
            rec.flush()
            time.sleep(self.settle_s)
            self._save(folder / picture_name(title, str(tab.name)))
            for view in views_of(tab):
                if not self._shows(view, scratch / "view.png"):
                    faults.append(f"{tab.name}: {view.name}: empty")
        reports = {f"{view.name}: {one}" for view in self.viewer.get_state().views for one in view.reports}
        return [*faults, *sorted(reports)]

    def _save(self, picture: Path, **view: str) -> None:
        """Save what the viewer shows; on a busy machine it may need more time than it gives itself."""
        for _ in range(TRIES - 1):
            with suppress(TimeoutError):
                self.viewer.save_screenshot(str(picture), **view)
                return
        self.viewer.save_screenshot(str(picture), **view)

    def _shows(self, view: Any, picture: Path) -> bool:
        """Return whether a view shows something, now or after a while: a busy machine draws late."""
        for _ in range(TRIES):
            self._save(picture, view_id=str(view.id))
            if not is_empty(view, picture):
                return True
            time.sleep(self.settle_s)
        return False


@contextmanager
def studio(settle_s: float = SETTLE_S, port: int | None = None) -> Iterator[Studio]:
    """Start a viewer without a screen, on any port or this one, and end it."""
    port = port or free_port(9871)
    os.environ.update(quiet_environment())
    viewer = ViewerClient.spawn(
        headless=True, port=port, executable_path=str(viewer_binary()), hide_welcome_screen=True
    )
    try:
        yield Studio(viewer, proxy_url(port), settle_s)
    finally:
        viewer.quit()


def picture_name(scene: str, tab: str) -> str:
    """Return the name of the file of a picture."""
    return f"{scene}-{tab.replace(' ', '-').lower()}.png"


def keep_small(picture: Path, name: str) -> None:
    """Put a picture into the docs without the menu bar, and its crops, with few colours."""
    whole = Image.open(picture).convert("RGB")
    for each, box in {name: (0, HEADER, *whole.size), **CROPS.get(name, {})}.items():
        whole.crop(box).quantize(COLORS).save(PICTURES / f"{each}.png", optimize=True)


def main() -> int:
    """Photograph scenes; return 1 when a picture is wrong."""
    found, faults = scenes(DATA), list[str]()
    parser = argparse.ArgumentParser(prog="scripts/screenshots", description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(found)}; default all")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the pictures of all tabs here")
    options = parser.parse_args()
    if unknown := set(options.scenes) - found.keys():
        parser.error(f"no scene {', '.join(sorted(unknown))}; there are: {', '.join(found)}")
    with tempfile.TemporaryDirectory(prefix="imumon-") as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name in options.scenes or found:
            setup, items = view_items(name, found[name])
            with studio() as place:
                faults += place.photograph(setup, items, folder, live=found[name].live)
            print(f"{name}: {found[name].shows}")
        for shown, (name, tab) in SHOWN.items():
            if (taken := folder / picture_name(name, tab)).exists():
                keep_small(taken, shown)
    for fault in faults:
        print(f"FAULT {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
