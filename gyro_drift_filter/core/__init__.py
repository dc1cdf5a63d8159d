"""The numbers: parameters, state and one step of the filter. No ROS, no files."""

from gyro_drift_filter.core.filter import Filter
from gyro_drift_filter.core.parameters import Parameters
from gyro_drift_filter.errors import GyroDriftFilterError, ParameterError

__all__ = ['Filter', 'GyroDriftFilterError', 'ParameterError', 'Parameters']
