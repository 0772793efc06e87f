"""What the pictures of the docs show: runs of a kind each, as view items, the same every time."""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from samples import crs05_model

from imumon.estimation.watch.stage import WatchParameters
from imumon.models.model import BiasModel
from imumon.protocols.device import DeviceFile, device_text, load_device, parse_device
from imumon.recordings.folder import open_session
from imumon.recordings.wire_reader import WireReader
from imumon.run.narration import Narrator
from imumon.run.replay import replay
from imumon.run.setup import Setup
from imumon.run.stages import pipeline_of
from imumon.simulation.recording import START_NS, record_session
from imumon.simulation.unit import load_scenario
from imumon.simulation.unit.motion import Handling, Vibration
from imumon.simulation.unit.scenario import Chamber, Step
from imumon.transport.reader import Bytes, Event, EventKind, Item
from imumon.transport.settings import PortSettings
from imumon.view.items import ViewItem, ViewSetup

_SHAKEN = [
    {"frequency_hz": 47.0, "acceleration_m_per_s2": (0.0, 0.0, 0.4), "tilt_deg": (0.004, 0.0, 0.0)},
    {"frequency_hz": 133.0, "acceleration_m_per_s2": (0.0, 0.0, 0.2), "tilt_deg": (0.002, 0.0, 0.0)},
]
_FAST = {"kind": "vibration", "at_s": 0.0, "duration_s": 20.0}
SHAKING = [Vibration.model_validate(_FAST | shaken) for shaken in _SHAKEN]
"""A motor and what it drives."""
_ROUNDS = {"at_s": 0.0, "rounds": 5, "every_s": 120.0, "rest_s": 10.0}
HANDLING = Handling.model_validate(
    _ROUNDS | {"kind": "handling", "swing_deg": (25.0, 16.0, 2.0), "heading_deg": 45.0}
)
"""As in the scenario warm-up, by gentler hands."""
TURNING = Chamber(start_degc=25.0, steps=[Step(to_degc=to, rate_degc_per_min=2.0) for to in (40.0, 25.0) * 5])
"""A chamber that always turns round, so that what is late shows."""
READ_S = 0.01
"""A capture has no times of arrival; it is taken to have come evenly, in reads of this length."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One run: what sends, what the estimators are given, and how it is looked at."""

    shows: str
    """For the list in the docs."""
    device: str
    record: Callable[[Path], Iterator[Item]]
    """Returns what came over the port, given a folder to work in."""
    setup: Callable[[], Setup] = field(default=Setup)
    live: bool = True
    """As it was shown live; else as a recording is opened afterwards."""
    baudrate: int | None = None


def view_items(name: str, scene: Scene) -> tuple[ViewSetup, list[ViewItem]]:
    """Return what the view receives of a scene: before the first sample, and then in order."""
    device = at_baud(load_device(scene.device), scene.baudrate)
    pipeline = pipeline_of(device, scene.setup())
    items: list[ViewItem] = []
    port = PortSettings("/dev/ttyUSB0", device.serial.baudrates[0])
    card = {"device": device.title, "port": str(port), "recording": f"sessions/{name}"}
    narrator = Narrator(pipeline, port, [items.append], lambda *_: None, card)
    with tempfile.TemporaryDirectory(prefix="imumon-") as folder:
        for _ in replay(scene.record(Path(folder)), pipeline, narrator):
            pass
    setup = ViewSetup(name, name, pipeline.units, z_down=device.axes == "FRD")
    return setup, items


def simulated(
    scenario: str,
    device: str,
    seconds: float,
    rate_hz: float = 100.0,
    baudrate: int | None = None,
    **changes: object,
) -> Callable[[Path], Iterator[Item]]:
    """Return a maker of what a virtual device sends when it plays this scenario, changed so."""

    def record(folder: Path) -> Iterator[Item]:
        text, source = device_text(device)
        description = at_baud(parse_device(text, source), baudrate)
        plan = load_scenario(scenario).model_copy(update={"duration_s": seconds, **changes})
        session = folder / "session"
        record_session(plan.played(rate_hz, description.axes), description, text, 0, session, lambda _: None)
        yield from WireReader(open_session(session).wire_path)

    return record


def at_baud(device: DeviceFile, baudrate: int | None) -> DeviceFile:
    """Return the device at another baud rate than its first."""
    if baudrate is None:
        return device
    return device.model_copy(update={"serial": device.serial.model_copy(update={"baudrates": [baudrate]})})


def capture(path: Path, seconds: float) -> Callable[[Path], Iterator[Item]]:
    """Return a maker of what is in a raw capture, as if it had come evenly within so many seconds."""

    def record(_: Path) -> Iterator[Item]:
        data = path.read_bytes()
        size = max(1, round(len(data) * READ_S / seconds))
        yield Event(EventKind.OPENED, START_NS, path.name)
        for at in range(0, len(data), size):
            yield Bytes(data[at : at + size], START_NS + round(at / len(data) * seconds * 1e9))

    return record


def model(tilt_z_dph: float = 0.0) -> BiasModel:
    """Return the curves of the simulated unit, where z is wrong by so many °/h per °C."""
    return crs05_model(("temperature_x", "temperature_y", "temperature_z"), tilt_z_dph)


def scenes(data: Path) -> dict[str, Scene]:
    """Return all scenes by name; captures are in the folder `data`, and left out where it is absent."""
    late = load_scenario("crs05-ramp-lag").unit.model_copy(update={"gyro_lag_s": (90.0,) * 3})
    found = {
        "demo": Scene("The demo: a virtual AHRS, after 105 s", "ax1", simulated("bench", "ax1", 105.0)),
        "recorded": Scene(
            "A warm-up in motion with a bias model, opened afterwards: rerun view.rrd",
            "ax1",
            simulated("warm-up", "ax1", 600.0, 50.0, motion=[HANDLING]),
            lambda: Setup(model=model(), latitude_deg=40.93),
            live=False,
        ),
        "wrong": Scene(
            "A warm-up at rest with a bias model that is wrong in z by 100 °/h over 30 °C, after 10 min",
            "ax1",
            simulated("warm-up", "ax1", 600.0, 20.0, motion=[]),
            lambda: Setup(model=model(100.0 / 30.0)),
        ),
        "alignment": Scene(
            "Alignment to north after 5 min",
            "xsens",
            simulated("alignment", "xsens", 300.0),
            lambda: Setup(latitude_deg=36.0),
        ),
        "isothermal": Scene(
            "A MEMS unit that rests at one temperature, for 4 min",
            "ax1",
            simulated("slow-rotation", "ax1", 240.0, motion=[]),
        ),
        "learning": Scene(
            "monitor --learn on a unit whose gyros are 90 s behind their thermometers, after 40 min",
            "ax1",
            simulated("crs05-ramp-lag", "ax1", 2400.0, 10.0, chamber=TURNING, unit=late),
            lambda: Setup(model=model(), watch=WatchParameters(learn=True)),
        ),
        "slow": Scene("The demo at 20 Hz, after 2 min", "ax1", simulated("bench", "ax1", 120.0, 20.0)),
        "fast": Scene(
            "A unit on a shaking table at 1 kHz, after 20 s",
            "xsens",
            simulated("bench", "xsens", 20.0, 1000.0, 2_000_000, motion=SHAKING),
            baudrate=2_000_000,
        ),
    }
    foreign = data / "microstrain" / "stream.bin"
    if foreign.exists():
        found["foreign"] = Scene(
            "A measured GNSS/INS stream, MIP at 125 Hz",
            "microstrain",
            capture(foreign, 18.1),
            baudrate=921_600,
        )
    return found
