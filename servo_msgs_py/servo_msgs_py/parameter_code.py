"""C code of the parameters: memory shared with the host, defaults, and the values of each axis and of the board.

Every list of the parameters in the firmware is generated here from the table of variables. A parameter has one element
per axis, or belongs to the board; its ``default`` is

* ``axis.MEMBER`` or ``-axis.MEMBER``: a member of the configuration block of its axis, which it follows;
* ``board.MEMBER``: a member of ``servo_config_t``;
* ``all`` (flags), or a value or its name.
"""

from __future__ import annotations

from typing import Final

from servo_msgs_py.board_parameters import PREFIX, parameters
from servo_msgs_py.catalogue import Catalogue, CatalogueError, Variable
from servo_msgs_py.value_text import labels_of, parse_number

_C_TYPES: Final = {"enum": "uint16_t", "flags": "uint16_t", "flags32": "uint32_t"}
_SIZES: Final = {"axes": "HAL_AXES", "analog_outs": "HAL_ANALOG_OUTS"}


def _name(parameter: Variable) -> str:
    return parameter.name.removeprefix(PREFIX)


def _is_of_axis(parameter: Variable) -> bool:
    return parameter.elements_of == "axes"


def _unit(parameter: Variable) -> str:
    if parameter.flags is not None:
        return f"{parameter.flags.removesuffix('s').upper()}_ bits: "
    if parameter.enum is not None:
        return f"{parameter.enum}: "
    return f"[{parameter.lsb:.4g} {parameter.unit}] " if parameter.unit else ""


def _declaration(parameter: Variable, array: str = "") -> str:
    return f"    {_C_TYPES.get(parameter.type, f'{parameter.type}_t')} {_name(parameter)}{array};"


def _array(parameter: Variable) -> str:
    if parameter.count == 1:
        return ""
    if parameter.elements_of not in _SIZES:
        raise CatalogueError(f"{parameter.name}: the count of a parameter is one of {', '.join(_SIZES)}")
    return f"[{_SIZES[parameter.elements_of]}]"


def parameter_header(catalogue: Catalogue) -> str:
    """The structures; members in the order of their sizes, so that there is no padding between them."""
    every = sorted(parameters(catalogue), key=lambda v: -v.element_size)
    for parameter in every:
        if parameter.path != f"parameter.{_name(parameter)}":
            raise CatalogueError(f"{parameter.name}: the path of this parameter is parameter.{_name(parameter)}")
    line = "\n".join
    padding = "\n    uint16_t unused; /* equal size on all processors */" if sum(v.size for v in every) % 4 else ""
    return f"""#ifndef SERVO_PARAMETERS_GEN_H
#define SERVO_PARAMETERS_GEN_H

#include "config/axis_config.h"

/* Written by the host at any time. */
typedef struct {{
{line(f"{_declaration(v, _array(v))} /* {_unit(v)}{v.text} */" for v in every)}{padding}
}} parameter_block_t;

/* The parameters of one axis in a slow tick. */
typedef struct {{
{line(_declaration(v) for v in every if _is_of_axis(v))}
}} axis_parameters_t;

/* The parameters of the board in a slow tick. */
typedef struct {{
{line(_declaration(v, _array(v)) for v in every if not _is_of_axis(v))}
}} board_parameters_t;

/* Set all parameters to their defaults: first those of the board, then those of each axis. */
void parameters_default_board(parameter_block_t *parameter, const servo_config_t *config);
void parameters_default_axis(parameter_block_t *parameter, uint16_t axis, const axis_config_t *config);

/* A parameter follows its default when the default changes. */
void parameters_renew(parameter_block_t *parameter, uint16_t axis, const axis_config_t *before,
                      const axis_config_t *after);

/* Copy the written values of an axis, and of the board. */
void parameters_of_axis(axis_parameters_t *to, const parameter_block_t *from, uint16_t axis);
void parameters_of_board(board_parameters_t *to, const parameter_block_t *from);

#endif
"""


def _configured(default: str) -> tuple[str, str, str]:
    """Sign, owner and member of a default in the configuration; the owner is empty for other defaults."""
    sign = "-" if default.startswith("-") else ""
    owner, _, member = default.removeprefix("-").partition(".")
    return (sign, owner, member) if owner in ("axis", "board") and member else ("", "", "")


def _default(parameter: Variable, catalogue: Catalogue) -> str:
    """C expression of the default, with ``config`` as the configuration of the owner."""
    sign, owner, member = _configured(parameter.default)
    if owner:
        if (owner == "axis") != _is_of_axis(parameter):
            raise CatalogueError(f"{parameter.name}: the configuration of the {owner} has no default for it")
        return f"{sign}config->{member}"
    try:
        if parameter.default == "all" and parameter.flags is not None:
            return f"UINT32_C({parameter.raw_range[1]})"
        return f"{parameter.to_raw(parse_number(parameter.default, labels_of(parameter, catalogue)))}"
    except ValueError as error:
        raise CatalogueError(f"{parameter.name}: default: {error}") from None


def _default_lines(parameter: Variable, catalogue: Catalogue) -> str:
    value = _default(parameter, catalogue)
    if parameter.count == 1:
        return f"    parameter->{_name(parameter)} = {value};"
    if _is_of_axis(parameter):
        return f"    parameter->{_name(parameter)}[axis] = {value};"
    return "\n".join(f"    parameter->{_name(parameter)}[{k}] = {value};" for k in range(parameter.count))


def _renew_lines(parameter: Variable) -> str:
    sign, _, member = _configured(parameter.default)
    return (
        f"    if (before->{member} != after->{member}) {{\n"
        f"        parameter->{_name(parameter)}[axis] = {sign}after->{member};\n"
        "    }"
    )


def _copy_lines(parameter: Variable) -> str:
    name = _name(parameter)
    if _is_of_axis(parameter):
        return f"    to->{name} = from->{name}[axis];"
    if parameter.count == 1:
        return f"    to->{name} = from->{name};"
    return "\n".join(f"    to->{name}[{k}] = from->{name}[{k}];" for k in range(parameter.count))


def parameter_source(catalogue: Catalogue) -> str:
    """The functions."""
    of_axis = [v for v in parameters(catalogue) if _is_of_axis(v)]
    of_board = [v for v in parameters(catalogue) if not _is_of_axis(v)]
    line = "\n".join
    return f"""/* clang-format off */
#include "config/parameters_gen.h"

void parameters_default_board(parameter_block_t *parameter, const servo_config_t *config)
{{
    *parameter = (parameter_block_t){{0}};
{line(_default_lines(v, catalogue) for v in of_board)}
}}

void parameters_default_axis(parameter_block_t *parameter, uint16_t axis, const axis_config_t *config)
{{
{line(_default_lines(v, catalogue) for v in of_axis)}
}}

void parameters_renew(parameter_block_t *parameter, uint16_t axis, const axis_config_t *before,
                      const axis_config_t *after)
{{
{line(_renew_lines(v) for v in of_axis if _configured(v.default)[1])}
}}

void parameters_of_axis(axis_parameters_t *to, const parameter_block_t *from, uint16_t axis)
{{
{line(map(_copy_lines, of_axis))}
}}

void parameters_of_board(board_parameters_t *to, const parameter_block_t *from)
{{
{line(map(_copy_lines, of_board))}
}}
"""
