"""The numbers: parameters, state and one step of the filter. No ROS, no files."""

from gyro_drift_filter.core.errors import GyroDriftFilterError, ParameterError
from gyro_drift_filter.core.filter import Filter
from gyro_drift_filter.core.parameters import Parameters

__all__ = ['Filter', 'GyroDriftFilterError', 'ParameterError', 'Parameters']
