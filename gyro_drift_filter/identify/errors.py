"""The errors of identification."""

from gyro_drift_filter.errors import GyroDriftFilterError


class IdentificationError(GyroDriftFilterError):
    """A recording, or an axis of it, can't be identified; the text says why and what to do."""
