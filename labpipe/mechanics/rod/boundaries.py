"""Boundaries of a line: grips, rings, strings, loads, planes and weight, with their paths.

A path has a row for the start and one for each step, shape (steps + 1, ...). A single row, or a
vector, is constant. Between two steps positions and forces are interpolated linearly, and frames
turn at a constant rate. Forces keep their direction in space.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from labpipe.mechanics.law.plays import require, require_not_negative, require_positive
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats

EARTH = (0.0, 0.0, -9.81)
"""Gravitational acceleration, m/s^2."""


def _check_path(name: str, values: object, width: int) -> Floats:
    """Return a path as read-only rows.

    Raises
    ------
    ValueError
        If it has another width or is not finite.
    """
    path: Floats = np.array(values, dtype=np.float64)
    path = path[None] if path.ndim == 1 else path
    if path.ndim != 2 or path.shape[1] != width or not len(path):
        shape = path.shape
        raise ValueError(
            format_sentence("mechanics.rod.path_shape", name=name, shape=shape, width=width)
        )
    is_finite = np.all(np.isfinite(path), axis=1)
    if not np.all(is_finite):
        row = f"{name}, row {int(np.argmin(is_finite))}"
        raise ValueError(format_sentence("mechanics.rod.not_finite", name=row))
    path.flags.writeable = False
    return path


def _check_direction(name: str, values: object) -> Floats:
    vector = _check_path(name, values, 3)
    size = float(np.linalg.norm(vector[0]))
    is_one = len(vector) == 1 and size > 0.0
    require(name, np.asarray(values).tolist(), "a direction, not zero", holds=is_one)
    unit: Floats = vector[0] / size
    unit.flags.writeable = False
    return unit


def _set_fields(record: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(record, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """A clamp or a pin at a node, which may move and may release the line.

    Parameters
    ----------
    node : from 0; negative numbers count from the end of the line, as in Python
    position : path, m, shape (steps + 1, 3)
    frame : path, unit quaternions, shape (steps + 1, 4), of the frame to which the elements at the
        node are clamped, with d3 along the line; None for a pin, which lets the line turn
    release : the first step without it; None if it never releases. Its reaction is removed at once
    name : for messages

    Raises
    ------
    ValueError
        If a path has another shape or is not finite, a frame is not of length one, or `release` is
        below 1.
    """

    node: int
    position: Floats
    frame: Floats | None = None
    release: int | None = None
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, position=_check_path("position", self.position, 3))
        if self.frame is not None:
            frame = _check_path("frame", self.frame, 4)
            if np.max(np.abs(np.linalg.norm(frame, axis=1) - 1.0)) > 1e-6:
                raise ValueError(format_sentence("mechanics.rod.not_unit", name="frame"))
            _set_fields(self, frame=frame)
        require("release", self.release, ">= 1", holds=self.release is None or self.release >= 1)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A frictionless ring through which the line slides.

    Parameters
    ----------
    position : path, m, shape (steps + 1, 3)
    direction : shape (3,), of its opening, for figures only
    near : node near which the line passes through it at the start; None for the nearest node
    name : for messages

    Raises
    ------
    ValueError
        If a vector has another shape or is not finite.
    """

    position: Floats
    direction: Floats = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    near: int | None = None
    name: str = ""

    def __post_init__(self) -> None:
        position = _check_path("position", self.position, 3)
        _set_fields(
            self, position=position, direction=_check_direction("direction", self.direction)
        )


@dataclass(frozen=True, slots=True, eq=False)
class String:
    """A weightless string from a node to an anchor; it pulls or is slack.

    Parameters
    ----------
    node : from 0, or negative from the end
    anchor : path, m, shape (steps + 1, 3)
    length : m, constant
    name : for messages

    Raises
    ------
    ValueError
        If the path has another shape or is not finite, or the length is not positive.
    """

    node: int
    anchor: Floats
    length: float
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, anchor=_check_path("anchor", self.anchor, 3))
        require_positive("length", self.length)


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """A force on a node, N, with its direction in space; a path of shape (steps + 1, 3)."""

    node: int
    force: Floats
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, force=_check_path("force", self.force, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane with Coulomb friction, on one side of which the line stays.

    The axis of the line stays half a diameter above it; friction acts on the axis.

    Parameters
    ----------
    point : shape (3,), m, on the plane
    normal : shape (3,), towards the side of the line
    friction : coefficient, >= 0
    name : for messages

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    point: Floats
    normal: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    friction: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        point = _check_path("point", self.point, 3)[0]
        _set_fields(self, point=point, normal=_check_direction("normal", self.normal))
        require_not_negative("friction", self.friction)

    def raised(self, height: float) -> Plane:
        """Return the plane raised by a height, m."""
        return replace(self, point=self.point + height * self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """Gravity: acceleration, m/s^2, a path of shape (steps + 1, 3); by default the earth's."""

    vector: Floats = field(default_factory=lambda: np.array(EARTH))
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, vector=_check_path("vector", self.vector, 3))


Boundary: TypeAlias = Held | Ring | String | Load | Plane | Gravity
