"""Files that are there whole or not at all, whatever ends the run."""

from pathlib import Path

from gyro_drift_filter.errors import GyroDriftFilterError, reason


def write_whole(path: Path, text: str) -> None:
    """Write a file, and the folders that it is in.

    Raises:
        GyroDriftFilterError: It can't be written.
    """
    unfinished = path.with_suffix('.incomplete')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(text, encoding='utf-8')
        unfinished.replace(path)
    except OSError as error:
        raise GyroDriftFilterError(f'{path} can not be written: {reason(error)}') from error
