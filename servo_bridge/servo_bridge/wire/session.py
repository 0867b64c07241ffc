"""Session with an identified board: its variables, with their meaning in the catalogue."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from typing import Final, Protocol, TypeVar

from servo_msgs_py.board_description import OtherBoardError, board_of, check_board
from servo_msgs_py.catalogue import Catalogue, Value, Variable
from servo_msgs_py.variable_table import texts_by_address

from servo_bridge.freemaster.client import BoardInfo, Client
from servo_bridge.freemaster.discovery import TableRow, discover
from servo_bridge.freemaster.errors import FreemasterError, OutOfRangeError, Status, StatusError
from servo_bridge.freemaster.tsa import Number, TargetVariable, TypeKind, parse_type
from servo_bridge.wire.refusal import refusal_text

T = TypeVar("T")

_HASH: Final = "catalogue_hash"
_SHOWN: Final = 4


class BoardMismatchError(FreemasterError):
    """The variables of the board do not match the catalogue; commands are not permitted."""

    def __init__(self, reason: str, remedy: str, *, foreign: bool = False) -> None:
        super().__init__(f"{reason}; {remedy}")
        self.reason = reason  # difference
        self.remedy = remedy  # action of the user
        self.foreign = foreign  # not a servo board


@dataclass(frozen=True)
class BoardVariable:
    """Variable of a board."""

    target: TargetVariable  # description by the board
    contract: Variable | None  # description by the catalogue, if the board matches it; values are then in SI units

    @property
    def name(self) -> str:
        """Name on the board."""
        return self.target.name

    @property
    def address(self) -> int:
        """Address on the board."""
        return self.target.address

    @property
    def size(self) -> int:
        """Bytes of all elements."""
        return self.target.size

    @property
    def count(self) -> int:
        """Elements; 1 for raw memory."""
        return self.target.count

    @property
    def unit(self) -> str:
        """SI unit; empty for dimensionless and unknown variables."""
        return "" if self.contract is None else self.contract.unit

    @property
    def is_block(self) -> bool:
        """Whether it is a memory block without a value."""
        return self.target.type.kind is TypeKind.RAW or (self.contract is not None and self.contract.type == "block")

    def decode(self, data: bytes) -> Value:
        """Value of all elements; for a block its bytes."""
        if self.is_block:
            return data
        if self.contract is not None:
            return self.contract.decode(data)
        return _as_value(self.target.decode(data))

    def encode(self, values: Sequence[Number], first: int = 0) -> tuple[int, bytes]:
        """Encode neighbouring elements.

        Parameters
        ----------
        values : sequence of numbers
            SI units if the catalogue has the variable.
        first : int
            Index of the first element.

        Returns
        -------
        address, data : int, bytes
            Address, and bytes to write.

        Raises
        ------
        ValueError
            If the variable is read-only, an element does not exist, or a value is out of limits.
        """
        if self.target.writable and self.is_block and self.target.members:
            raise ValueError(f"{self.name} is a structure; write its members, such as {self.target.members[0]}")
        if not self.target.writable or self.is_block:
            raise ValueError(f"{self.name} can only be read")
        if not values or first < 0 or first + len(values) > self.count:
            raise ValueError(f"{self.name} has {self.count} element(s), not {first} .. {first + len(values) - 1}")
        if self.contract is not None:
            return self.encode_raw([self.contract.to_raw(value) for value in values], first)
        data = b"".join(self.target.type.encode(value, self.target.order) for value in values)
        return self.address + first * self.target.type.size, data

    def encode_raw(self, raw: Sequence[int], first: int = 0) -> tuple[int, bytes]:
        """Encode neighbouring elements given as firmware integers; see `encode`."""
        if self.contract is None or not self.target.writable:
            raise ValueError(f"{self.name} can only be read")
        offset, data = self.contract.encode_part(raw, first)
        return self.address + offset, data


@dataclass(frozen=True)
class Session:
    """Session with an identified board."""

    client: Client  # client of the board
    catalogue: Catalogue  # meaning of the variables of matching boards
    info: BoardInfo  # identification by the board
    variables: Mapping[str, BoardVariable]  # of the board, by name
    mismatch: BoardMismatchError | None  # reason if the board does not match the catalogue; values are then raw numbers

    def read(self, variable: BoardVariable) -> Value:
        """Read one variable."""
        return variable.decode(self.client.read_memory(variable.address, variable.size))

    def write(self, variable: BoardVariable, values: Sequence[Number], first: int = 0) -> None:
        """Write neighbouring elements of one variable; see `BoardVariable.encode` and `write_bytes`."""
        address, data = variable.encode(values, first)
        self.write_bytes(variable, data, address - variable.address)

    def write_bytes(self, variable: BoardVariable, data: bytes, offset: int = 0) -> None:
        """Write whole neighbouring elements, `offset` bytes after the address of a variable.

        Variables of the catalogue are written in one frame, others in pieces that fit the buffer of the target.

        Raises
        ------
        OutOfRangeError
            If the board refuses a value of a variable of the catalogue.
        """
        contract = self.variables[variable.name].contract  # also for a variable used with raw numbers
        if contract is not None:
            self.write_contract(contract, data, offset, lengthy=True)
            return
        limit = self.client.write_limit(variable.address)
        step = max(limit - limit % variable.target.type.size, variable.target.type.size)
        for start in range(0, len(data), step):
            self.client.write_memory(variable.address + offset + start, data[start : start + step], lengthy=True)

    def write_contract(self, contract: Variable, data: bytes, offset: int, *, lengthy: bool) -> None:
        """Write whole neighbouring elements of a variable of the catalogue in one frame.

        Raises
        ------
        OutOfRangeError
            If the board refuses a value.
        """
        try:
            self.client.write_memory(self.variables[contract.name].target.address + offset, data, lengthy=lengthy)
        except StatusError as error:
            if error.code != Status.OUT_OF_RANGE:
                raise
            raise OutOfRangeError(refusal_text(self.catalogue, contract, data, offset)) from error


def _known_texts(
    read_hash: Callable[[int], int], catalogue: Catalogue, rows: Sequence[TableRow]
) -> Mapping[int, bytes]:
    """Texts of the variable table if the board matches this catalogue; reading them would triple the time."""
    texts = texts_by_address(catalogue, [row[:2] for row in rows])
    for name, _, address, _ in rows if texts else ():
        if texts[name] == _HASH.encode():
            with suppress(StatusError):
                if read_hash(address) == catalogue.hash:
                    return texts
    return {}


def connect(client: Client, catalogue: Catalogue) -> Session:
    """Identify a board, read its table of variables and compare it with the catalogue.

    Raises
    ------
    FreemasterError
        If there is no response, another protocol, or no table of variables.
    """
    info = client.identify()
    read_hash = cache(lambda address: int.from_bytes(client.read_memory(address, 4), "little"))
    targets = {target.name: target for target in discover(client, info, partial(_known_texts, read_hash, catalogue))}
    mismatch: BoardMismatchError | None = None
    try:
        found = targets.get(_HASH)
        reported = None if found is None or found.size != 4 else read_hash(found.address)
        check_contract(catalogue, info, targets, reported)
    except BoardMismatchError as error:
        mismatch = error
    contracts = catalogue.variables if mismatch is None else {}
    variables = {name: BoardVariable(target, contracts.get(name)) for name, target in targets.items()}
    return Session(client, catalogue, info, variables, mismatch)


class Call(Protocol):
    """Calls a function with the session of the board in the thread of the link, as `Link.call`."""

    def __call__(self, function: Callable[[Session], T]) -> Future[T]: ...


def check_contract(
    catalogue: Catalogue, info: BoardInfo, targets: Mapping[str, TargetVariable], reported_hash: int | None
) -> None:
    """Check that all variables of a board match the catalogue.

    Raises
    ------
    BoardMismatchError
        If they do not match, with the differences.
    """
    name = info.name or info.description or "the board"
    if reported_hash is None:
        raise BoardMismatchError(
            f"{name} has no variable {_HASH}: it does not run the servo firmware",
            "use the port of the servo board, or flash the firmware of this release",
            foreign=True,
        )
    if (board := board_of(info.name)) is not None:
        try:
            check_board(board, catalogue.board)
        except OtherBoardError as error:
            remedy = f"connect the board {catalogue.board.name}, or use the release that belongs to this firmware"
            raise BoardMismatchError(str(error), remedy) from None
    remedy = "flash the firmware of this release, or use the host software of the board's release"
    if reported_hash != catalogue.hash:
        raise BoardMismatchError(
            f"the firmware of {name} has another table of variables "
            f"(hash {reported_hash:08X}, this program {catalogue.hash:08X})",
            remedy,
        )
    wrong = [text for v in catalogue.variables.values() if (text := _difference(v, targets.get(v.name), info))]
    if wrong:
        more = f" and {len(wrong) - _SHOWN} more" if len(wrong) > _SHOWN else ""
        raise BoardMismatchError(
            f"the table of variables of {name} contradicts its hash: {'; '.join(wrong[:_SHOWN])}{more}", remedy
        )


def _difference(variable: Variable, target: TargetVariable | None, info: BoardInfo) -> str:
    """Difference between a variable of the board and the catalogue; empty if there is none."""
    if target is None:
        return f"{variable.name} is missing"
    if variable.type == "block":
        return ""
    if info.big_endian and variable.element_size > 1:
        return f"{variable.name} has its high byte first"
    if target.size != variable.size:
        return f"{variable.name} has {target.size} bytes instead of {variable.size}"
    if variable.writable and not target.writable:
        return f"{variable.name} is read-only"
    expected = parse_type(bytes((variable.format.tsa,)), variable.size)
    assert expected is not None
    same_bits = (target.type.kind, target.type.size, target.type.fraction_bits) == (
        expected.kind,
        expected.size,
        expected.fraction_bits,
    )
    same_name = variable.enum is None or target.type.name in (variable.enum, expected.name)
    return (
        "" if same_bits and same_name else f"{variable.name} is of type {target.type.name} instead of {variable.type}"
    )


def _as_value(decoded: Number | list[Number] | bytes) -> Value:
    """Narrow the type of a list, whose elements are of one kind."""
    if isinstance(decoded, list):
        return [float(v) for v in decoded] if isinstance(decoded[0], float) else [int(v) for v in decoded]
    return decoded
