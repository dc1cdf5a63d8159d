"""What can go wrong in a calibration."""

from gyro_drift_filter.errors import GyroDriftFilterError


class CalibrationError(GyroDriftFilterError):
    """A recording does not tell scale and misalignment; the text says why and what to do."""
