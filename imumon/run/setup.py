"""Pipeline files: what the estimators need to know that the device does not send."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, get_args

from pydantic import Field, ValidationError, field_validator, model_validator

from imumon.config import Retired, StrictModel, dump_yaml, parse_yaml, retired, wrong_arguments
from imumon.errors import bad_config
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.rest.parameters import GyroBiasParameters, RestParameters
from imumon.estimation.watch.stage import WatchParameters
from imumon.files import as_path, read_text
from imumon.models.model import BiasModel, MagnetometerModel, load_model
from imumon.protocols.device import DeviceFile
from imumon.protocols.ranges import Ranges
from imumon.recordings.folder import Session

from . import PublishedMethod

FORMAT: Final = "imumon-pipeline/1"

ZuptMode = Literal["standard", "thermal", "learned"]
Channel = Literal["gyro_x", "gyro_y", "gyro_z"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)

Size = Annotated[float, Field(ge=0.0)]
Axes = Annotated[list[Size | None], Field(min_length=3, max_length=3)]
"""x, y, z; None where the data show none."""
NONE: Axes = [None, None, None]


class GyroNoise(StrictModel):
    """Noise of the gyros, as ``imumon allan --noise-out`` writes it."""

    angle_random_walk_rad_per_sqrt_s: Axes = NONE
    bias_instability_rad_per_s: Axes = NONE
    rate_random_walk_rad_per_s_sqrt_s: Axes = NONE
    quantization_rad: Axes = NONE
    rate_ramp_rad_per_s2: Axes = NONE
    correlated_noise_rad_per_s: Axes = NONE
    correlation_time_s: Axes = NONE


class AccelNoise(StrictModel):
    """Noise of the accelerometers, as ``imumon allan --noise-out`` writes it."""

    velocity_random_walk_m_per_s_sqrt_s: Axes = NONE
    bias_instability_m_per_s2: Axes = NONE
    acceleration_random_walk_m_per_s2_sqrt_s: Axes = NONE
    quantization_m_per_s: Axes = NONE
    acceleration_ramp_m_per_s3: Axes = NONE
    correlated_noise_m_per_s2: Axes = NONE
    correlation_time_s: Axes = NONE


class Noise(StrictModel):
    """The noise section of a pipeline YAML."""

    gyro: GyroNoise | None = None
    accel: AccelNoise | None = None


class AllanParameters(StrictModel):
    """The live Allan curves have nothing to set; the lines of data sheets of before are read and named."""

    gyro_sheet: Retired = None
    accel_sheet: Retired = None


class AxisNoise(StrictModel):
    """Noise of a gyro axis, as Allan deviations give it; at least one kind of drift is needed.

    Parameters
    ----------
    angle_random_walk : float
        rad/√s, that is rad/s/√Hz.
    bias_instability : float, optional
        rad/s; B of IEEE Std 952, so that the Allan deviation has a floor at 0.664 B.
    rate_random_walk : float, optional
        rad/s/√s.
    """

    angle_random_walk: float = Field(gt=0.0, le=1.0)
    bias_instability: float | None = Field(default=None, ge=0.0, le=1.0)
    rate_random_walk: float | None = Field(default=None, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _drifts(self) -> Self:
        if not self.bias_instability and not self.rate_random_walk:
            raise ValueError("neither bias_instability nor rate_random_walk: leave the axis out to learn it")
        return self


class RandomErrorParameters(StrictModel):
    """How the published filters estimate the random error of gyros; every key has a default.

    Parameters
    ----------
    assume_rest : bool
        Whether the unit is at rest throughout when it is not stated (no column ``at_rest``).
    noise : mapping of gyro_x, gyro_y, gyro_z to AxisNoise
        What is known of an axis; others are learnt.
    learn_s : float
        s at rest from which the noise is learnt before SR-RSUKF starts.
    mean_s, hold_s : float
        Time constant of the exponential mean, and s at rest of which the hold is the mean.
    method, risk, phi_limit
        Not used any more; ``method: sr_rsukf`` is as ``published: [sr_rsukf]``.
    """

    method: Literal["drift", "sr_rsukf"] = "drift"
    assume_rest: bool = False
    noise: dict[Channel, AxisNoise] = Field(default_factory=dict)
    learn_s: float = Field(default=60.0, ge=10.0, le=86400.0)
    mean_s: float = Field(default=100.0, ge=1.0, le=86400.0)
    hold_s: float = Field(default=60.0, ge=1.0, le=86400.0)
    risk: Retired = None
    phi_limit: Retired = None


class Setup(StrictModel):
    """Where the unit stands, its bias model, and the parameters of every estimator.

    `model` is the path of a model file, relative to the pipeline file, or the model itself; a session keeps
    the model itself, so that it refers to nothing outside.  `noise` is what `imumon allan --noise-out`
    writes; it holds for every estimator whose own parameters do not state another.  `published` names methods
    of the papers that run beside the defaults.
    """

    format: Literal["imumon-pipeline/1"] = FORMAT
    latitude_deg: float | None = Field(default=None, ge=-90, le=90)
    heading_deg: float | None = Field(default=None, ge=-360, le=360)
    zupt_mode: ZuptMode | None = None
    model: BiasModel | str | None = None
    range: Ranges = Ranges()
    rest: RestParameters = RestParameters()
    zupt: GyroBiasParameters = GyroBiasParameters()
    random_error: RandomErrorParameters = RandomErrorParameters()
    attitude: AttitudeParameters = AttitudeParameters()
    alignment: AlignmentParameters = AlignmentParameters()
    watch: WatchParameters = WatchParameters()
    noise: Noise = Noise()
    allan: AllanParameters = AllanParameters()
    published: list[PublishedMethod] = Field(default_factory=list)

    if not TYPE_CHECKING:  # type checkers know the arguments from the fields

        def __init__(self, **given: Any) -> None:
            """Check the arguments; raises BAD_CONFIG, naming each that is wrong."""
            try:
                super().__init__(**given)
            except ValidationError as error:
                raise bad_config(f"Setup: {wrong_arguments(error)}") from error
            if isinstance(self.model, str):  # only `load_setup` knows the folder that it is relative to
                raise bad_config(
                    f"Setup: model={self.model!r}: expected a bias model", "use imumon.load_model(path)"
                )

        # Else pydantic calls it for files as well, whose errors `parse_yaml` gives with their lines.
        __init__.__pydantic_base_init__ = True

    @field_validator("published")
    @classmethod
    def _once(cls, given: list[PublishedMethod]) -> list[PublishedMethod]:
        if len(set(given)) < len(given):
            raise ValueError("a method is named twice")
        return given

    @property
    def bias_model(self) -> BiasModel | None:
        """The bias over temperature, or None; a path has been replaced by `load_setup`."""
        assert not isinstance(self.model, str)
        return self.model if self.model is not None and self.model.channels else None

    @property
    def magnetometer(self) -> MagnetometerModel | None:
        """Hard and soft iron, where the model file has them."""
        return self.model.magnetometer if isinstance(self.model, BiasModel) else None

    @property
    def mode(self) -> ZuptMode:
        """How the bias follows temperature: as chosen, else by the model if there is one, else learned."""
        return self.zupt_mode or ("thermal" if self.bias_model is not None else "learned")

    @property
    def zupt_with_noise(self) -> GyroBiasParameters:
        """Parameters of the bias estimator, with the noise that is known filled in."""
        gyro, own = self.noise.gyro, self.zupt
        if gyro is None:
            return own
        known: dict[str, Axes] = {}
        white = gyro.angle_random_walk_rad_per_sqrt_s
        if own.angle_random_walk_rad_per_sqrt_s is None and all(white):
            known["angle_random_walk_rad_per_sqrt_s"] = white
        flicker, walk = gyro.bias_instability_rad_per_s, gyro.rate_random_walk_rad_per_s_sqrt_s
        is_open = own.bias_instability_rad_per_s is None and own.rate_random_walk_rad_per_s_per_sqrt_s is None
        if is_open and all(f or w for f, w in zip(flicker, walk, strict=True)):
            known["bias_instability_rad_per_s"] = [value or 0.0 for value in flicker]
            known["rate_random_walk_rad_per_s_per_sqrt_s"] = [value or 0.0 for value in walk]
        return own.model_copy(update=known)

    @property
    def methods(self) -> list[PublishedMethod]:
        """Methods of the papers that run beside the defaults: `published`, and that of a retired key."""
        is_old = self.random_error.method == "sr_rsukf" and "sr_rsukf" not in self.published
        return [*self.published, "sr_rsukf"] if is_old else self.published

    @property
    def random_error_with_noise(self) -> RandomErrorParameters:
        """Parameters of the random error, with the noise that is known filled in."""
        gyro, own = self.noise.gyro, self.random_error
        if gyro is None:
            return own
        known = {
            channel: AxisNoise(angle_random_walk=white, bias_instability=flicker, rate_random_walk=walk)
            for channel, white, flicker, walk in zip(
                CHANNELS,
                gyro.angle_random_walk_rad_per_sqrt_s,
                gyro.bias_instability_rad_per_s,
                gyro.rate_random_walk_rad_per_s_sqrt_s,
                strict=True,
            )
            if white and (flicker or walk)
        }
        return own.model_copy(update={"noise": {**known, **own.noise}})

    def with_options(self, **given: Any) -> "Setup":
        """Return the setup with what was given on the command line; None leaves what there is."""
        changed = {name: value for name, value in given.items() if value is not None}
        return self.model_copy(update=changed).checked()

    def checked(self) -> "Setup":
        """Return the setup; raises BAD_CONFIG when its parts contradict each other."""
        if self.zupt_mode == "thermal" and self.bias_model is None:
            raise bad_config(
                "the thermal mode needs the bias over temperature, and there is no model",
                "add --model MODEL.yaml, made by: imumon calibrate SESSION... --out MODEL.yaml",
            )
        return self

    def text(self) -> str | None:
        """Return the pipeline file that states this much, or None when nothing differs from the defaults."""
        defaults = Setup()
        names = {name for name in Setup.model_fields if getattr(self, name) != getattr(defaults, name)}
        return dump_yaml({"format": FORMAT, **self.model_dump(include=names)}) if names else None


def unused_keys(setup: Setup, device: DeviceFile | None) -> list[str]:
    """Return texts on the keys of a setup and of a device's thermometers that are not used any more."""
    sections = {**dict(setup), "temperature": None if device is None else device.temperature}
    found = {
        f"{name}: {key}": ""
        for name, section in sections.items()
        if isinstance(section, StrictModel)
        for key in retired(section)
    }
    if setup.random_error.method != "drift":
        found["random_error: method"] = ", it is as published: [sr_rsukf]"
    if device is not None and device.temperature.method != "level_bank":
        found["temperature: method"] = ", it is as published: [fir]"
    return [f"{key} is not used any more{instead}" for key, instead in found.items()]


def parse_setup(text: str, source: str) -> Setup:
    """Read the text of a pipeline file; a model that it names is read from beside `source`.

    Raises BAD_CONFIG, naming file and line, what was found and what was expected.
    """
    setup = parse_yaml(text, Setup, source)
    if isinstance(setup.model, str):
        setup = setup.model_copy(update={"model": load_model(Path(source).parent / setup.model)})
    return setup.checked()


def recorded_setup(session: Session) -> Setup:
    """Return the setup that a session ran with.

    Raises BAD_CONFIG when what it keeps of it cannot be read.
    """
    text = session.metadata.pipeline_yaml
    return Setup() if text is None else parse_setup(text, f"{session.path} (pipeline_yaml)")


def load_setup(path: str | Path) -> Setup:
    """Read a pipeline file.

    Raises BAD_CONFIG, naming file and line, what was found and what was expected.
    """
    text = read_text(as_path(path), hint=f"give a pipeline file (format: {FORMAT})")
    return parse_setup(text, str(path))
