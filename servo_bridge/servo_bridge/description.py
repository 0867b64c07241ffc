"""Print the robot description of a bridge from its parameter file; the bridge need not run.

``python -m servo_bridge.description --params my.yaml > servo.urdf``
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import yaml
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.robot_description import describe
from servo_msgs_py.text_file import read_text

from servo_bridge.parameters import PARAMETERS, ParameterError, Settings, settings_from
from servo_msgs_py import argument, topics


def settings_from_file(params: str = "", namespace: str = "") -> Settings:
    """Settings of a bridge that is started with a parameter file; arguments and errors as `description_from_file`."""
    node = f"{_board(namespace)}/servo_bridge"
    values = {name: spec.default for name, spec in PARAMETERS.items()}
    if params:
        try:
            sections = yaml.safe_load(read_text(Path(params)))
            named = [key for key in sections if key in (node, node[1:])]
            given = parameter_dict_from_yaml_file(params, True, target_nodes=named or ["/**"])
        except (OSError, RuntimeError, TypeError, ValueError, yaml.YAMLError) as error:
            raise ParameterError(f"parameter file {params}: {error}") from None
        values |= {name: parameter_value_to_python(given[name].value) for name in PARAMETERS if name in given}
    return settings_from(values, Catalogue.load())


def description_from_file(params: str = "", namespace: str = "") -> str:
    """Robot description that the bridge will publish.

    Parameters
    ----------
    params : str
        Parameter file of the bridge; empty: the defaults.
    namespace : str
        Namespace before ``servo``, as in the launch files.

    Returns
    -------
    str
        URDF.

    Raises
    ------
    ParameterError
        If the file cannot be read, or its values are invalid.
    """
    settings, board = settings_from_file(params, namespace), _board(namespace)
    return describe(
        settings.joints,
        Catalogue.load(),
        commands_topic=f"{board}/{topics.JOINT_COMMANDS}",
        states_topic=f"{board}/{topics.JOINT_STATES}",
        interfaces=settings.command_interfaces,
    )


def _board(namespace: str) -> str:
    """Namespace of a board."""
    return f"{'/' if namespace.strip('/') else ''}{namespace.strip('/')}/servo"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; exit status 2 if the parameter file is invalid."""
    parser = argument.Parser(
        prog="servo_bridge.description", description="Print the robot description (URDF) of a bridge."
    )
    parser.add_argument("--params", default="", metavar="FILE", help="parameter file (default: the bridge's defaults)")
    parser.add_argument(
        "--namespace", type=argument.namespace, default="", metavar="NS", help="of the launch, before `servo`"
    )
    args = parser.parse_args(argv)
    try:
        print(description_from_file(args.params, args.namespace), end="")
    except ParameterError as error:
        print(f"servo_bridge.description: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
