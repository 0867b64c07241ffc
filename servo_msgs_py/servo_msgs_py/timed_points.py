"""Timed points of a trajectory as the words of ``cmd.points`` (``firmware/app/points.c``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from servo_msgs_py.catalogue import AXES, Catalogue

POINT_WORDS: Final = 4
POINTS_PER_WRITE: Final = 8
"""Maximum number of points in one write."""
POINTS_MEASURING: Final = 2
"""The same during a measurement."""

_PART_BITS: Final = 12
_AXIS_BIT: Final = 28
_REPLACE_BIT: Final = 29
_WRAP: Final = 1 << 32


@dataclass(frozen=True)
class TimedPoint:
    """Position, velocity and feed-forward current of an axis at a tick."""

    axis: int  # index of the axis
    tick: int  # PWM periods since the reset of the board, modulo 2^32
    position: float  # [rad], unlimited: the board uses it modulo 2^32 counts
    velocity: float  # [rad/s]
    current: float = 0.0  # feed-forward i_q in addition to the one for acceleration and friction [A]
    replaces: bool = False  # first remove the queued points from this tick on

    def shifted(self, ticks: int) -> TimedPoint:
        """The same point, a number of PWM periods later."""
        return replace(self, tick=(self.tick + ticks) % _WRAP)


def encode_points(catalogue: Catalogue, points: Sequence[TimedPoint]) -> list[int]:
    """Words of points in the same order: `POINT_WORDS` each.

    Raises
    ------
    ValueError
        If there are none or too many of them, or a velocity or current is outside the range of the board.
    """
    if not 0 < len(points) <= POINTS_PER_WRITE:
        raise ValueError(f"{len(points)} points in one write; 1 to {POINTS_PER_WRITE} are possible")
    words: list[int] = []
    for point in points:
        if not 0 <= point.axis < AXES:
            raise ValueError(f"axis {point.axis} does not exist")
        whole, part = divmod(
            round(point.position / catalogue["axis1.position"].lsb * (1 << _PART_BITS)), 1 << _PART_BITS
        )
        speed = catalogue["axis1.speed"].to_raw(point.velocity)
        current = catalogue["axis1.i_q"].to_raw(point.current)
        last = current & 0xFFFF | part << 16 | point.axis << _AXIS_BIT | point.replaces << _REPLACE_BIT
        words += [_signed(word) for word in (point.tick, whole, speed, last)]
    return words


def decode_points(catalogue: Catalogue, words: Sequence[int]) -> list[TimedPoint]:
    """Points from words; positions within 2^31 counts of 0.

    Raises
    ------
    ValueError
        If the number of words is not a positive multiple of `POINT_WORDS`.
    """
    if not words or len(words) % POINT_WORDS:
        raise ValueError(f"{len(words)} words are not complete points of {POINT_WORDS} words")
    lsb, speed, current = (catalogue[f"axis1.{name}"].lsb for name in ("position", "speed", "i_q"))
    points: list[TimedPoint] = []
    for k in range(0, len(words), POINT_WORDS):
        tick, whole, raw_speed, last = words[k : k + POINT_WORDS]
        raw_current = (last + 0x8000) % 0x1_0000 - 0x8000
        part = last >> 16 & (1 << _PART_BITS) - 1
        points.append(
            TimedPoint(
                axis=last >> _AXIS_BIT & 1,
                tick=tick % _WRAP,
                position=(whole + part / (1 << _PART_BITS)) * lsb,
                velocity=raw_speed * speed,
                current=raw_current * current,
                replaces=bool(last >> _REPLACE_BIT & 1),
            )
        )
    return points


def axes_of_points(words: Sequence[int]) -> int:
    """Bit mask of the axes with points; bit 0 is axis 1."""
    mask = 0
    for last in words[POINT_WORDS - 1 :: POINT_WORDS]:
        mask |= 1 << (last >> _AXIS_BIT & 1)
    return mask


def periods_ahead(words: Sequence[int], tick: int) -> int:
    """Time from a tick to the first of encoded points [PWM periods]; negative if the point is earlier."""
    return _signed(words[0] - tick)


def shifted_points(words: Sequence[int], ticks: int, counts: Sequence[int], axes: int) -> list[int]:
    """Words of the points of selected axes for another board, shifted in time and position.

    Parameters
    ----------
    words : sequence of int
        Of complete points.
    ticks : int
        PWM periods added to the ticks.
    counts : sequence of int
        Counts added to the positions, by axis.
    axes : int
        Bit mask of the selected axes.
    """
    shifted: list[int] = []
    for k in range(0, len(words), POINT_WORDS):
        tick, whole, speed, last = words[k : k + POINT_WORDS]
        axis = last >> _AXIS_BIT & 1
        if axes >> axis & 1:
            shifted += [_signed(tick + ticks), _signed(whole + counts[axis]), speed, last]
    return shifted


def _signed(word: int) -> int:
    return (word + 0x8000_0000) % _WRAP - 0x8000_0000
