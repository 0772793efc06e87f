"""The effects there are."""

from imumon.effects.base import Effect
from imumon.effects.hysteresis import Hysteresis
from imumon.effects.product import GSensitivity, Product
from imumon.effects.since_power_on import Drift, Periodic, RunOffset, Step, StressRelaxation, WarmUp
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.effects.temperature_rate import TemperatureRate
from imumon.effects.thermal_lag import DeadTime, ThermalLag

_KINDS: tuple[type[Effect], ...] = (
    TemperatureCurve,
    TemperatureRate,
    ThermalLag,
    DeadTime,
    Hysteresis,
    WarmUp,
    StressRelaxation,
    Drift,
    Step,
    RunOffset,
    Periodic,
    GSensitivity,
    Product,
)
KINDS: dict[str, type[Effect]] = {kind.name: kind for kind in _KINDS}
"""imumon's own, by the name of their kind, in the order in which they are tried."""
