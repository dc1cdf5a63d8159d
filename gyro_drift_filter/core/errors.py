"""The errors that this package raises on purpose."""


class GyroDriftFilterError(Exception):
    """A known error: its text is one line that says what is wrong and what to do."""


class ParameterError(GyroDriftFilterError):
    """A parameter has a wrong name, type or value."""
