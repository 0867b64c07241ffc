"""What ran in a recording: the document of the topic `topics.RUN_INFO`.

It is JSON in a ``std_msgs/String``, published again when something changes. Unknown members are ignored, and missing
ones are not known.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import Any, Final

from servo_msgs_py.text_file import TextFileError, parse_json

FORMAT: Final = 1
"""Version of the document; a reader refuses a higher one."""


class RunInfoError(ValueError):
    """The document is damaged or too new; the text has the reason and a remedy."""


@dataclass(frozen=True, kw_only=True)
class VirtualBoard:
    """What a virtual board is, as its program reports it."""

    device: str = ""  # of its serial port
    level: str = ""  # of the model: registers or ideal
    seed: int = 0  # of the sensor noise
    speed: float = 1.0  # simulated seconds per second
    baud: float = 0.0  # speed of its serial line [bit/s]
    plant: str = ""  # all values of the plant, TOML as in plant.toml
    flash: str = ""  # SHA-256 of the data flash at power-on; empty: erased
    build: str = ""  # SHA-256 of the compiled board: firmware and model
    faults: Sequence[str] = ()  # injected faults
    robot: str = ""  # MuJoCo model that its shafts move, a file or an example; empty: none
    robot_sha256: str = ""  # of the compiled model


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    """What ran; see the members."""

    software: str = ""  # version of this project
    catalogue: str = ""  # hash of the table of variables of the bridge, 8 hexadecimal digits
    board: Mapping[str, str] = field(default_factory=dict)
    """Identification: name, version and build of the firmware, hardware (name of the board); empty: not connected."""
    tick_ns: int = 0  # period of the ticks of the board [ns]
    parameters: Mapping[str, Sequence[int]] = field(default_factory=dict)  # of the board, raw numbers by name
    configuration: Sequence[Mapping[str, int]] = ()  # block by axis, raw numbers by member; empty: not known
    bridge: Mapping[str, Any] = field(default_factory=dict)  # parameters of the node of the bridge
    virtual_board: VirtualBoard | None = None  # None: a real board, or not known

    def text(self) -> str:
        """JSON document."""
        return json.dumps({"format": FORMAT, **asdict(self)}, separators=(",", ":"))


def software_version() -> str:
    """Version of this project."""
    return version("servo_msgs_py")


def run_info(text: str) -> RunInfo:
    """Read a document.

    Raises
    ------
    RunInfoError
        If it is damaged, or of a later version.
    """
    try:
        table = parse_json(text)
        found = table["format"]
        if found > FORMAT:
            raise RunInfoError(f"the run info has format {found}, newer than {FORMAT}; use a newer version")
        if table.get("virtual_board") is not None:
            table["virtual_board"] = VirtualBoard(**known(VirtualBoard, table["virtual_board"]))
        return RunInfo(**known(RunInfo, table))
    except (TextFileError, TypeError, KeyError, AttributeError) as error:
        raise RunInfoError(f"the run info is damaged: {error!r}; record again") from None


def string_of(data: bytes) -> str:
    """Text of a serialised ``std_msgs/String``.

    Raises
    ------
    RunInfoError
        If it is damaged.
    """
    try:
        order = "<" if data[1] & 1 else ">"
        (size,) = struct.unpack_from(f"{order}I", data, 4)
        return data[8 : 8 + size - 1].decode()
    except (IndexError, struct.error, UnicodeDecodeError):
        raise RunInfoError("the message is no string; record again") from None


def known(kind: type[Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of a table that are members of a data class whose members have defaults.

    Raises
    ------
    TypeError
        If one has another type than its default.
    """
    defaults = vars(kind())
    found = {name: value for name, value in table.items() if name in defaults}
    for name, value in found.items():
        if not isinstance(value, _KINDS.get(type(defaults[name]), object)):
            raise TypeError(f"{name} is {value!r}")
    return found


_KINDS: Final[Mapping[type, type | tuple[type, ...]]] = {
    str: str,
    int: int,
    float: (int, float),
    tuple: (list, tuple),
    dict: dict,
}
"""Types of JSON by that of a default."""
