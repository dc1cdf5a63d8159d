"""Read ROS 2 parameter files, so that `replay` takes the file that the node takes."""

import logging
import re
from pathlib import Path
from typing import Any

from gyro_drift_filter.core import GyroDriftFilterError, ParameterError, Parameters
from gyro_drift_filter.core.parameters import DESCRIPTIONS, OF_EVERY_NODE, unknown_name
from gyro_drift_filter.messages.health import NODE_NAME

_log = logging.getLogger(__name__)

LARGEST_FILE = 1_000_000  # bytes

_NAMES = {description.name for description in DESCRIPTIONS}


def read_parameters(path: Path) -> Parameters:
    """Return the filter's parameters from a ROS 2 parameter file.

    Taken are the sections that rcl gives to a node called gyro_drift_filter, in whatever namespace;
    `*` stands for one part of a name and `**` for any number. A parameter that does not exist is an
    error in a section that names the node; in one for many nodes it draws a logged warning, as
    it may be meant for another.

    Raises:
        ParameterError: The file can't be read, has no such section or several for different
            namespaces, a parameter that does not exist or a wrong value.
        GyroDriftFilterError: PyYAML is missing.
    """
    sections = _ours(path, _load(path))
    values: dict[str, Any] = {}
    for name, content in sections.items():
        for key, value in _flat('', content).items():
            if key.split('.')[0] in OF_EVERY_NODE:
                continue
            if key in _NAMES:
                values[key] = value
            elif '*' in name:
                _log.warning('parameter file %s: %s', path, unknown_name(key))
            else:
                raise ParameterError(f'parameter file {path}: {unknown_name(key)}')
    try:
        return Parameters.from_names(values)
    except ParameterError as error:
        raise ParameterError(f'parameter file {path}: {error}') from error


def _load(path: Path) -> dict[Any, Any]:
    try:
        import yaml
    except ImportError as error:
        raise GyroDriftFilterError(
            "parameter files need the Python package PyYAML: install it with 'pip install PyYAML' "
            "or 'apt install python3-yaml'"
        ) from error

    class Loader(yaml.SafeLoader):
        """YAML as rcl reads it: 2e-5 is a number, where PyYAML wants 2.0e-5, and no aliases."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            # A few lines of them can stand for more values than there is memory.
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError('aliases (*name) are not taken')
            return super().compose_node(parent, index)

    Loader.add_implicit_resolver(
        'tag:yaml.org,2002:float',
        re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$'),
        list('-+0123456789.'),
    )
    try:
        # A subclass of SafeLoader.
        document = yaml.load(_text(path), Loader)
    except OSError as error:
        raise ParameterError(f'parameter file {path}: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ParameterError(
            f'parameter file {path} is no YAML: {" ".join(str(error).split())}'
        ) from error
    if not isinstance(document, dict):
        raise ParameterError(f'parameter file {path} holds no node names')
    return document


def _text(path: Path) -> str:
    with path.open('rb') as file:
        data = file.read(LARGEST_FILE + 1)
    if len(data) > LARGEST_FILE:
        raise ParameterError(f'parameter file {path} is longer than {LARGEST_FILE} bytes')
    return data.decode('utf-8')


def _ours(path: Path, document: dict[Any, Any]) -> dict[str, dict[Any, Any]]:
    """Return the sections of our node by their names, wildcards first as the weaker ones."""
    found = {
        name: content
        for name, content in _sections('', document)
        if name.rpartition('/')[2] in (NODE_NAME, '*', '**')
    }
    if not found:
        raise ParameterError(
            f"parameter file {path} has no section '{NODE_NAME}' with 'ros__parameters' in it"
        )
    named = [name for name in found if '*' not in name]
    if len(named) > 1:
        raise ParameterError(
            f'parameter file {path} has sections for several nodes: {", ".join(named)}: leave one'
        )
    return dict(sorted(found.items(), key=lambda item: '*' not in item[0]))


def _sections(prefix: str, document: dict[Any, Any]) -> list[tuple[str, dict[Any, Any]]]:
    """Return node names and their parameters; namespaces may be nested or joined by slashes."""
    found = []
    for key, value in document.items():
        if not isinstance(value, dict):
            continue
        name = f'{prefix}/{str(key).strip("/")}'
        content = value.get('ros__parameters')
        if isinstance(content, dict):
            found.append((name, content))
        nested = {k: v for k, v in value.items() if k != 'ros__parameters'}
        found += _sections(name, nested)
    return found


def _flat(prefix: str, values: dict[Any, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f'{prefix}{key}'
        if isinstance(value, dict):
            flat |= _flat(f'{name}.', value)
        else:
            flat[name] = value
    return flat
