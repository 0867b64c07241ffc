"""Version 4 of the protocol: encoding of requests and decoding of responses."""

from __future__ import annotations

import hashlib

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.board_info import DEFAULT_MTU, BoardInfo
from servo_bridge.freemaster.errors import FreemasterError, Status, StatusError
from servo_bridge.freemaster.frames import V4, decode_uleb
from servo_bridge.freemaster.line import Fence, SendRequest
from servo_bridge.freemaster.recorder import Recorder
from servo_bridge.freemaster.recorder_v4 import RecorderV4


def password_key(password: str, salt: bytes) -> bytes:
    """Key of a password for the login: two rounds of SHA-1 with the salt of the target."""
    inner = hashlib.sha1(password.encode("utf-8"), usedforsecurity=False).digest()
    return hashlib.sha1(salt + inner + salt, usedforsecurity=False).digest()


class DialectV4:
    """Version 4. Independent of the identification of the target.

    Methods return requests and raise `CodecError` for arguments that the version does not support; methods named
    ``parse_...`` decode the data of a response.
    """

    read_memory = staticmethod(commands.read_memory)
    write_memory = staticmethod(commands.write_memory)
    set_scope = staticmethod(commands.set_scope)
    read_scope = staticmethod(commands.read_scope)
    get_tsa_info = staticmethod(commands.get_tsa_info)
    parse_tsa_info = staticmethod(commands.parse_tsa_info)
    get_string_length = staticmethod(commands.get_string_length)
    parse_size = staticmethod(commands.parse_size)
    send_command = staticmethod(commands.send_command)
    get_command_status = staticmethod(commands.get_command_status)
    exchange_pipe = staticmethod(commands.exchange_pipe)

    def identify(self, send: SendRequest) -> BoardInfo:
        """Identify the target."""

        def text(key: str) -> str:
            value = self.get_config(send, key)
            return "" if value is None else value.split(b"\x00", 1)[0].decode("utf-8", "replace")

        def byte(key: str) -> int:
            value = self.get_config(send, key)
            return value[0] if value else 0

        def number(key: str) -> int | None:
            value = self.get_config(send, key)
            return decode_uleb(value)[0] if value else None

        return BoardInfo(
            mtu=max(number("MTU") or DEFAULT_MTU, DEFAULT_MTU),
            flags=byte("F1"),
            protocol=byte("PV") or 4,
            version=text("VS"),
            name=text("NM"),
            description=text("DS"),
            build=text("BD"),
            base_address=number("BA"),
            recorders=byte("RC"),
            scopes=byte("SC"),
            pipes=byte("PC"),
        )

    def fence(self, send: SendRequest) -> Fence | None:
        """Request whose response never changes; after `identify`."""
        fence: Fence | None = None
        for key in ("VS", "PV"):
            request = commands.get_config(key)
            try:
                response = send(request)
            except StatusError:
                continue  # a refusal cannot be distinguished from other refusals
            answer = V4.answer(response.status, response.data)
            if fence is None or fence.answer != answer:
                fence = Fence(request.frame, answer, fence)
        return fence

    def get_config(self, send: SendRequest, key: str) -> bytes | None:
        """Read a configuration value; None if it does not exist."""
        try:
            return commands.parse_config(key, send(commands.get_config(key)).data)
        except StatusError as error:
            if error.code in (Status.ACCESS_DENIED, Status.UNKNOWN_COMMAND):
                return None
            raise

    def log_in(self, send: SendRequest, level: int, password: str) -> int:
        """Log in with a password; returns the granted level.

        Raises
        ------
        StatusError
            If the password is wrong.
        FreemasterError
            If this program does not support the passwords of the board; version 3 has none.
        """
        challenge = send(commands.begin_login(level)).data
        algorithm, end = decode_uleb(challenge)
        if algorithm == commands.NO_PASSWORD:
            return level
        if algorithm != commands.SHA1_PASSWORD:
            raise FreemasterError(
                f"the board requires passwords hashed by algorithm {algorithm}; this program supports SHA-1"
            )
        return send(commands.finish_login(level, password_key(password, challenge[end:]))).data[0]

    def recorder(self, send: SendRequest, info: BoardInfo, index: int, payload_limit: int) -> Recorder:
        """Return the recorder with this number."""
        return RecorderV4(send, index, payload_limit)
