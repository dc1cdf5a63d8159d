"""Read ROS 2 parameter files, so that `replay` takes the file that the node takes."""

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from gyro_drift_filter.bags.health import NODE_NAME
from gyro_drift_filter.core import GyroDriftFilterError, ParameterError, Parameters

try:
    import yaml
except ImportError as error:
    raise GyroDriftFilterError(
        "parameter files need the Python package PyYAML: install it with 'pip install PyYAML' or "
        "'apt install python3-yaml'"
    ) from error

# What every ROS 2 node has, and the offline tools have no use for.
_OF_EVERY_NODE = ('use_sim_time', 'qos_overrides', 'start_type_description_service')


def read_parameters(path: Path) -> Parameters:
    """Return the filter's parameters from a ROS 2 parameter file.

    Taken are the sections whose name matches a node called gyro_drift_filter, as rcl matches them:
    with any namespace, `*` for one part of a name and `**` for any number.

    Raises:
        ParameterError: The file can't be read, has no such section, an unknown parameter or a
            wrong value.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ParameterError(f'parameter file {path}: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ParameterError(
            f'parameter file {path} is no YAML: {" ".join(str(error).split())}'
        ) from error
    if not isinstance(document, dict):
        raise ParameterError(f'parameter file {path} holds no node names')
    values: dict[str, Any] = {}
    found = False
    for section, content in _sections('', document):
        if _is_ours(section):
            found = True
            values |= _flat('', content)
    if not found:
        raise ParameterError(
            f"parameter file {path} has no section '{NODE_NAME}' with 'ros__parameters' in it"
        )
    ours = {k: v for k, v in values.items() if k.split('.')[0] not in _OF_EVERY_NODE}
    try:
        return Parameters.from_names(ours)
    except ParameterError as error:
        raise ParameterError(f'parameter file {path}: {error}') from error


def _sections(prefix: str, document: dict[Any, Any]) -> list[tuple[str, dict[Any, Any]]]:
    """Return node names and their parameters; namespaces may be nested or joined by slashes."""
    found = []
    for key, value in document.items():
        if not isinstance(value, dict):
            continue
        name = f'{prefix}/{str(key).strip("/")}'
        for inner, content in value.items():
            if inner == 'ros__parameters' and isinstance(content, dict):
                found.append((name, content))
        nested = {k: v for k, v in value.items() if k != 'ros__parameters'}
        found += _sections(name, nested)
    return found


def _is_ours(section: str) -> bool:
    name = section.rpartition('/')[2]
    return fnmatchcase(NODE_NAME, name)


def _flat(prefix: str, values: dict[Any, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f'{prefix}{key}'
        if isinstance(value, dict):
            flat |= _flat(f'{name}.', value)
        else:
            flat[name] = value
    return flat
