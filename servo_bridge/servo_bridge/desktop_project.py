"""Project file for the FreeMASTER desktop tool: every variable of the board with its unit, scale and limits.

The tool (FreeMASTER 3) stores its project in a ``.pmpx`` file: an XML archive of objects that refer to each other by
name. The contents of the objects are derived from projects that NXP publishes; the generated files have not been tested
with the tool itself. Addresses are symbol names: the tool finds them in the variable table of the board.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from servo_msgs_py.catalogue import AXES, Catalogue, Variable, axis_name

Member = tuple[str, str, object]
"""Name, type and value of a member."""

_VERSION: Final = "3.2.2.2"  # of the tool that writes archives of this form
_UNSIGNED, _SIGNED = 0, 1
_DECIMAL, _HEX, _REAL = 0, 1, 4
_ALL_DIGITS: Final = 2**31 - 1
_PERIOD_MS: Final = 200
_SCOPE_PERIOD: Final = 0.01  # [s]
_SCOPE_BLOCKS: Final = 6
_COLORS: Final = (0x0000C0, 0xC00000, 0x008000, 0x808000, 0x800080, 0x606060)
_WATCHED: Final = ("state", "substate", "faults", "position", "speed", "i_q", "i_d", "i_q_ref")
_CURVES: Final = ("position", "speed", "speed_ref", "i_q", "i_q_ref", "i_d")


class _Archive:
    """Objects in the order of their addition; the first is the document."""

    def __init__(self) -> None:
        self._objects: list[tuple[str, Sequence[Member]]] = []

    def reserve(self) -> str:
        """Add an empty object that is filled later; returns its name."""
        self._objects.append(("", ()))
        return f"ObjId{len(self._objects) - 1:04}"

    def fill(self, name: str, kind: str, members: Sequence[Member] = ()) -> str:
        """Set type and members of a reserved object; returns its name."""
        self._objects[int(name.removeprefix("ObjId"))] = (kind, members)
        return name

    def add(self, kind: str, members: Sequence[Member] = ()) -> str:
        """Add an object; returns its name."""
        return self.fill(self.reserve(), kind, members)

    def list_of(self, names: Iterable[str]) -> str:
        """Add a list of objects."""
        return self.add("CObList", [(f"item{k}", "CObject_ptr", name) for k, name in enumerate(names)])

    def text(self) -> str:
        """Contents of the file."""
        root = ET.Element("xmlarchive", schema="65535")
        ET.SubElement(ET.SubElement(root, "main"), "member", name="document", type="CPrjDoc").text = "ObjId0000"
        objects = ET.SubElement(root, "objects")
        for number, (kind, members) in enumerate(self._objects):
            element = ET.SubElement(objects, "object", name=f"ObjId{number:04}", type=kind)
            for name, type_, value in members:
                ET.SubElement(element, "member", name=name, type=type_).text = _value_text(type_, value)
        ET.indent(root, "\t")
        head = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
        return head + ET.tostring(root, encoding="unicode") + "\n"


def _value_text(kind: str, value: object) -> str | None:
    if kind in ("uint8", "uint32"):
        return f"0x{value:X}"
    if kind in ("real32", "real64"):
        return f"{value:.{8 if kind == 'real32' else 20}e}"
    return None if value == "" else str(value)


def _strings(**texts: object) -> list[Member]:
    return [(name, "string", text) for name, text in texts.items()]


def _numbers(**values: int) -> list[Member]:
    return [(name, "sint32", value) for name, value in values.items()]


def desktop_project(catalogue: Catalogue, baud: int = 115_200) -> str:
    """Return a project file.

    Parameters
    ----------
    catalogue : Catalogue
        Variables of the board; memory blocks are omitted.
    baud : int
        Default line speed in the tool [bit/s].

    Returns
    -------
    str
        Content of a ``.pmpx`` file, UTF-8.
    """
    archive = _Archive()
    document = archive.reserve()
    enums = [_enum(archive, name, values) for name, values in catalogue.enums.items()]
    variables = {
        name: _variable(archive, variable, name)
        for variable in catalogue.variables.values()
        if variable.type != "block"
        for name in _element_names(variable)
    }
    enum_list = archive.add("CEnumList", [("enums_list", "CObListEx", archive.list_of(enums))])
    root = _tree(archive, variables, "dual-axis PMSM servo")
    archive.fill(
        document,
        "CPrjDoc",
        [
            ("version", "string", _VERSION),
            ("enum_db_man", "CEnumList", enum_list),
            ("variables", "CObListEx", archive.list_of(variables.values())),
            ("stimulators", "CObListEx", archive.list_of(())),
            ("functions", "CObListEx", archive.list_of(())),
            ("function_msgs", "CMapWordToObEx", archive.add("CMapWordToOb")),
            ("mapfile_types", "CObListEx", archive.list_of(())),
            ("mapfile_list", "CObListEx", archive.list_of(())),
            *_numbers(mapfile_current=-1, mapfile_listerr_ena=1, mapfile_listerr_mode=0, mapfile_pre_select=0),
            *_numbers(comm_params_saved=1, comm_state_saved=0, comm_state_enabled=0, comm_port=1),
            *_strings(comm_port_hint="COM_ALL"),
            *_numbers(comm_speed=baud),
            *_strings(comm_rs232_conn=f"RS232;port=COM_ALL;speed={baud};"),
            *_numbers(comm_plugin_use=0),
            *_strings(comm_plugin_id="", comm_plugin_conn=""),
            *_numbers(cthread_boosting=0, cthread_prio_base=3, cthread_prio_boost=3),
            *_strings(tmpdir_orig="", html_control_page=""),
            *_numbers(html_rendering_engine=2),
            ("html_auth_xobjects", "CStringListEx", archive.add("CStringList")),
            *_numbers(demo_enable=0, demo_protect=0),
            *_strings(demo_password=""),
            ("project_root", "CObject_ptr", root),
            ("flash_prog", "CFlashProgDlg", archive.add("CFlashProgDlg", _FLASH)),
            *_numbers(have_packed_files=0, have_layout_data=0),
        ],
    )
    return archive.text()


_FLASH: Final[Sequence[Member]] = (  # as written by the tool for a project without flash programming
    *_numbers(is_default=1),
    *_strings(csw_addr="fprgCSW"),
    *_numbers(csw_size=1),
    *_strings(buff_addr="fprgBuff"),
    *_numbers(buff_size=0, ex_addr=0),
    *_strings(file_name=""),
    *_numbers(dis_csum_err=0),
    ("mem_offset", "uint32", 0),
    *_numbers(flash_type=0),
    ("filt_start", "uint32", 0),
    ("filt_size", "uint32", 0x100),
    ("timeout", "uint32", 5000),
    *_numbers(erase_before_write=0, verify_after_write=0, block_safe_write=0),
)


# ---- variables ----------------------------------------------------------------------------------------------------
def _element_names(variable: Variable) -> list[str]:
    return [variable.name] if variable.count == 1 else [f"{variable.name}[{k}]" for k in range(variable.count)]


def _enum(archive: _Archive, name: str, values: Mapping[str, int]) -> str:
    items = [
        archive.add(
            "CEnumItem",
            [*_strings(name=word, value_min=number, value_max=""), *_numbers(inclusive_min=1, inclusive_max=1)],
        )
        for word, number in values.items()
    ]
    return archive.add("CEnum", [*_strings(name=name), ("items", "CObListEx", archive.list_of(items))])


def _variable(archive: _Archive, variable: Variable, name: str) -> str:
    """Add one number; value = lsb * raw."""
    scaled = variable.lsb != 1.0
    transformation = "NULL"
    if scaled:
        linear: list[Member] = [
            *_strings(a=repr(variable.lsb), b="0"),
            ("var_a", "CObject_ptr", "NULL"),
            ("var_b", "CObject_ptr", "NULL"),
        ]
        transformation = archive.add("CNumTrfLinAB", linear)
    limits = ("", "")
    if variable.writable and variable.enum is None and variable.flags is None:
        limits = (f"{variable.minimum:.9g}", f"{variable.maximum:.9g}")
    return archive.add(
        "CVariable",
        [
            *_strings(name=name, unit=variable.unit or "-"),
            *_numbers(period=_PERIOD_MS),
            *_strings(address=name),
            ("last_addr", "uint32", 0),
            *_numbers(byte_size=variable.element_size),
            *_strings(description=variable.text, comment=""),
            *_numbers(virtual=0),
            *_strings(virtual_default="0"),
            *_numbers(treat_as=_SIGNED if variable.format.signed else _UNSIGNED),
            *_strings(type_fmt="Fixed point number"),
            *_numbers(bit_shift=0),
            *_strings(bit_mask="no mask (-1)"),
            ("value_trf", "CObject_ptr", transformation),
            *_numbers(enum_enabled=int(variable.enum is not None), enum_num_always=0),
            *_strings(enum_default_val="unknown"),
            *_numbers(enum_num_with_default=1),
            *_strings(enum=variable.enum or ""),
            *_numbers(show_as=_REAL if scaled else _HEX if variable.flags is not None else _DECIMAL),
            *_numbers(show_val=1, show_max=0, show_min=0),
            *_numbers(show_num_fixed_digs=_ALL_DIGITS, show_num_lzero_fill=0, show_num_afp_digs=_ALL_DIGITS),
            *_numbers(show_num_exp=0, show_ascii_zterm=0, show_ascii_rev=0, show_ascii_hex=1, show_ascii_chwdt=1),
            *_numbers(filt_enabled=0, filt_reset_onmod=1),
            ("filt_time", "uint32", 5000),
            *_numbers(modif_mode=int(variable.writable), modif_edit_mode=2, modif_set_mode=0),
            *_numbers(modif_auto_fin=1, modif_auto_hide=1),
            ("modif_predefs_modes", "uint32", 1),
            *_strings(modif_predefs_other="", modif_set_min=limits[0], modif_set_max=limits[1], modif_set_step=""),
            *_strings(modif_address=""),
            ("modif_last_addr", "uint32", 0),
        ],
    )


# ---- tree -----------------------------------------------------------------------------------------------------------
def _tree(archive: _Archive, variables: dict[str, str], title: str) -> str:
    """Add a root with the variables of the board, and a block with a scope per axis."""
    root = archive.reserve()
    blocks = []
    for number in range(1, AXES + 1):
        axis = axis_name(number - 1)
        block = archive.reserve()
        scope = _scope(archive, block, axis, {name: variables[f"{axis}.{name}"] for name in _CURVES})
        watched = [variables[f"{axis}.{name}"] for name in _WATCHED]
        blocks.append(_block(archive, block, "CPrjItemBlock", axis, watched, [scope], parent=root))
    board = [reference for name, reference in variables.items() if name.startswith("cmd.") or "." not in name]
    return _block(archive, root, "CPrjItemProject", title, board, blocks, parent="NULL")


def _item(parent: str, name: str) -> list[Member]:
    return [
        ("parent_item", "CObject_ptr", parent),
        *_numbers(tree_expand=1, data_capture_mode=0, data_capture_onaction=0, data_capture_file_type=0),
        *_strings(data_capture_dir=""),
        *_numbers(data_absolute_time=0),
        *_strings(name=name, href=""),
    ]


def _block(
    archive: _Archive, block: str, kind: str, name: str, watched: Sequence[str], children: Sequence[str], parent: str
) -> str:
    columns = [
        archive.add("CPrjItemBlock_ColInfo", _numbers(column_visible=1, column_width=width, column_ix=index))
        for index, width in enumerate((160, 120, 80, 70, 300))
    ]
    cell: list[Member] = [
        *_strings(font_name="Tahoma"),
        ("font_set", "uint8", 0),
        ("font_size", "real32", 8.0),
        *_numbers(font_bold=0, font_italic=0, font_underline=0, alignment=33),
        ("backcolor", "uint32", 0xFFFFFF),
        ("forecolor", "uint32", 0),
    ]
    return archive.fill(
        block,
        kind,
        [
            *_item(parent, name),
            ("watch_variables", "CObListEx", archive.list_of(watched)),
            ("watch_functions", "CObListEx", archive.list_of(())),
            ("child_items", "CObList", archive.list_of(children)),
            ("cell_format", "CPrjItemBlock_CellFormat", archive.add("CPrjItemBlock_CellFormat", cell)),
            (
                "column_info",
                "CObArrayEx",
                archive.add("CObArray", [(f"index{k}", "CObject_ptr", column) for k, column in enumerate(columns)]),
            ),
            ("variable_info", "CMapObToObEx", archive.add("CMapObToObEx")),
            *_numbers(show_grid=1, show_bar=1, ena_row_sizing=1, ena_col_sizing=1, ena_col_swapping=1),
            *_numbers(ena_inplace_params=1, ena_inplace_values=1),
        ],
    )


def _scope(archive: _Archive, parent: str, axis: str, curves: dict[str, str]) -> str:
    """Add an oscilloscope with the curves of an axis, each with its own y axis."""
    infos = [
        archive.add(
            "CPrjItemRS_VarInfo",
            [
                ("variable", "CObject_ptr", reference),
                *_numbers(visible=1, y_block=k),
                ("color", "uint32", _COLORS[k]),
            ],
        )
        for k, reference in enumerate(curves.values())
    ]
    names = [*curves, *[""] * _SCOPE_BLOCKS][:_SCOPE_BLOCKS]
    y_blocks = [archive.add("CPrjItemRS_YBlockInfo", _y_block(name)) for name in names]
    return archive.add(
        "CPrjItemScope",
        [
            *_item(parent, f"{axis} scope"),
            *_numbers(graph_buffer=10_000, graph_type=0, graph_x_units=2),
            *_strings(graph_x_label="Time"),
            *_numbers(graph_x_addunits=1, graph_legend_loc=0, graph_legen_vis=1, graph_legend_inside=1),
            *_numbers(graph_grid_horz=1, graph_grid_vert=1),
            ("graph_x_min", "real64", 0.0),
            ("graph_x_max", "real64", 100.0),
            *_numbers(graph_x_min_auto=1, graph_x_max_auto=1, graph_break_line=0),
            *_numbers(graph_var_count=len(infos), var_count=len(infos)),
            *((f"var{k}_info", "CPrjItemRS_VarInfo", info) for k, info in enumerate(infos)),
            *((f"yblock{k}_info", "CPrjItemRS_YBlockInfo", block) for k, block in enumerate(y_blocks)),
            ("scope_period", "real64", _SCOPE_PERIOD),
            *_numbers(scope_x_autoscale=1),
            ("scope_x_width", "real64", 10.0),
            *_numbers(scope_ignore_duplicity=0),
        ],
    )


def _y_block(label: str) -> list[Member]:
    def side(name: str, text: str) -> list[Member]:
        return [
            *_strings(**{f"{name}_label": text}),
            *_numbers(**{f"{name}_style": 0}),
            (f"{name}_min", "real64", -10.0),
            (f"{name}_max", "real64", 10.0),
            *_numbers(**{f"{name}_min_auto": 1, f"{name}_max_auto": 1}),
        ]

    return [*_numbers(join_class=0), *side("laxis", label), *side("raxis", ""), *_numbers(raxis_subsets=0)]
