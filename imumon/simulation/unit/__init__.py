"""A simulated inertial unit with known errors: scenario files, physics, and the truth beside what is sent."""

from .scenario import Scenario, load_scenario, load_unit
from .unit import TRUTH_COLUMNS, SimulatedUnit

__all__ = ["TRUTH_COLUMNS", "Scenario", "SimulatedUnit", "load_scenario", "load_unit"]
