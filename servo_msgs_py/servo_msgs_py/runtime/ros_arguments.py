"""Command-line arguments with the parameters of a node."""

from __future__ import annotations

import json
from pathlib import PurePath


def parameter_arguments(**parameters: object) -> list[str]:
    """Arguments that give a node these parameters.

    rcl reads a value as YAML: unquoted, ``run #1.rrd`` would be ``run``, and ``[new] 1.rrd`` an error. JSON is a part
    of YAML that quotes every text. Characters beyond ASCII are not escaped, because YAML has no surrogate pairs.

    Parameters
    ----------
    **parameters
        Numbers, texts, paths, and lists of them, by name.
    """
    if not parameters:
        return []
    return ["--ros-args", *(word for name, value in parameters.items() for word in ("-p", f"{name}:={_yaml(value)}"))]


def _yaml(value: object) -> str:
    return json.dumps(str(value) if isinstance(value, PurePath) else value, ensure_ascii=False)
