"""The errors that this package raises on purpose, and text from elsewhere made fit to show."""


def printable(text: str) -> str:
    """Return text in one line, without characters that a terminal acts on."""
    return ''.join(c if c.isprintable() else '\ufffd' for c in ' '.join(text.split()))


def reason(error: BaseException) -> str:
    """Return the text of an error in one line, or its name where it has no text."""
    return printable(str(error)) or type(error).__name__


class GyroDriftFilterError(Exception):
    """A known error: its text is one line that says what is wrong and what to do."""

    def __str__(self) -> str:
        """Return the text; names from files and messages may be in it."""
        return printable(super().__str__())


class ParameterError(GyroDriftFilterError):
    """A parameter has a wrong name, type or value."""
