"""Parameters of the attitude, in a module of their own that loads quickly."""

from pydantic import Field

from imumon.config import Retired, StrictModel


class AttitudeParameters(StrictModel):
    """Which sensors are used, and what is declared of their errors.

    Parameters
    ----------
    use_magnetometer : bool
        Whether the heading is taken from the magnetometer, where there is one.
    accel_bias_m_per_s2 : float, optional
        Standard deviation of the accelerometers' error at rest.  When it is not given, 7.6 mg are taken, and
        more where the magnitude of the specific force shows more.
    gyro_scale : float, optional
        Standard deviation of each element of the gyros' matrix of scale and misalignment, 1 % in a calibrated
        unit.  When it is not given, 2 % are taken, and what turns show.
    """

    use_magnetometer: bool = True
    accel_bias_m_per_s2: float | None = Field(default=None, ge=0.0, le=10.0)
    gyro_scale: float | None = Field(default=None, ge=0.0, le=0.5)
    accel_error_probability: Retired = None
    axes_error_probability: Retired = None
    magnet_error_probability: Retired = None
    accel_doubt: Retired = None
    axes_doubt: Retired = None
    magnet_doubt: Retired = None
