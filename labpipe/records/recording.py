"""Define the content of an export (channels with clocks, marker tracks) and the known formats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, NamedTuple

import numpy as np

from labpipe.records.arrays import ArrayRecord, Floats, Unit, Vector
from labpipe.records.quality import QualityNote


class ExportFormat(NamedTuple):
    """A format that labpipe reads.

    Parameters
    ----------
    name : name in protocols
    module : reader of the format, imported when it is needed
    is_text, is_workbook : whether its files can be text or binary files, and whether they can be
        workbooks
    has_markers : whether its exports contain marker tracks instead of channels
    """

    name: str
    module: str
    is_text: bool = True
    is_workbook: bool = False
    has_markers: bool = False


EXPORT_FORMATS: Final = (
    ExportFormat("dspace-mat", "labpipe.readers.dspace_mat"),
    ExportFormat("dspace-csv", "labpipe.readers.dspace_csv"),
    ExportFormat("dspace-mf4", "labpipe.readers.dspace_mf4"),
    ExportFormat("motive-csv", "labpipe.readers.motive_takes", has_markers=True),
    ExportFormat(
        "motive-xlsx",
        "labpipe.readers.motive_takes",
        is_text=False,
        is_workbook=True,
        has_markers=True,
    ),
    ExportFormat("load-frame", "labpipe.readers.load_frame", is_workbook=True),
)
"""Known formats, in the order in which `labpipe inspect` tries them."""


@dataclass(frozen=True, slots=True, eq=False)
class Clock(ArrayRecord):
    """One time axis of an export, unchanged.

    Parameters
    ----------
    name : name in the export (a raster, a task), or ``time``
    time : shape (n,), in `unit`; with the holes, the jitter and the start of the export
    unit : ``s``; ``1`` where the export has no time and `time` only counts the rows, from 0
    """

    name: str
    time: Annotated[Floats, "sample", Unit(stated_in="unit")]
    unit: str = "s"


@dataclass(frozen=True, slots=True, eq=False)
class Channel(ArrayRecord):
    """One named signal with a unit and a clock.

    Parameters
    ----------
    name : short name; need not be unique within an export
    path : full name that is unique within an export, such as ``Model Root/Subsystem/In1``
    values : shape (n,), in `unit`; NaN where the export is blank
    clock : name of its clock
    unit : SI unit of `values`; None if neither file nor protocol states a unit: `values` are then
        those of the file
    unit_in_file : unit as the export writes it; empty if it states none
    calibration : description of the conversion from the numbers of the file to `values`; empty if
        they are equal
    """

    name: str
    path: str
    values: Vector
    clock: str = "time"
    unit: str | None = None
    unit_in_file: str = ""
    calibration: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class RigidBody(ArrayRecord):
    """Pose of a rigid body in every frame, in the frame of the motion-capture system.

    Parameters
    ----------
    name : name of the body
    position : shape (frames, 3), m; NaN where the body was not tracked
    rotation : shape (frames, 4), quaternion in the order x, y, z, w; NaN where not tracked, or in
        all frames when the export gives none
    error : shape (frames,), m, mean marker error; NaN where the export gives none
    """

    name: str
    position: Annotated[Floats, "frame", "xyz", Unit("m")]
    rotation: Annotated[Floats, "frame", "xyzw", Unit("1")]
    error: Annotated[Floats, "frame", Unit("m")]


@dataclass(frozen=True, slots=True, eq=False)
class MarkerTracks(ArrayRecord):
    """Measured marker positions and rigid bodies over the frames of one take.

    Parameters
    ----------
    time : shape (frames,), s; frame number / export rate where the export states a rate
    frames : shape (frames,), frame numbers of the export
    rate : frames per second as stated, or derived from the time stamps
    names : one per marker; unique within a take (a repeated name carries its id after a blank)
    positions : shape (frames, markers, 3), m, in the frame of the motion-capture system; NaN
        where the marker was not tracked
    bodies : the rigid bodies of the take
    unit_in_file : unit of length as the export writes it; empty if it states none
    """

    time: Annotated[Floats, "frame", Unit("s")]
    frames: Annotated[Floats, "frame", Unit("1")]
    rate: float
    names: Annotated[tuple[str, ...], "marker"]
    positions: Annotated[Floats, "frame", "marker", "xyz", Unit("m")]
    bodies: tuple[RigidBody, ...] = ()
    unit_in_file: str = ""

    def body(self, name: str) -> RigidBody | None:
        """Find a rigid body by its name; None if the take has no such body."""
        return next((body for body in self.bodies if body.name == name), None)

    @property
    def missing(self) -> dict[str, int]:
        """Return the number of frames in which each marker was not tracked."""
        blank = np.isnan(self.positions).any(axis=2).sum(axis=0)
        return {name: int(count) for name, count in zip(self.names, blank, strict=True)}


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Content of one export.

    Parameters
    ----------
    reader : name of the reader that made it
    program, program_version : stated in the export; empty if it does not state them
    clocks : the time axes
    channels : the signals
    markers : marker tracks of a motion-capture export, else None
    metadata : further content of the header, in types of JSON
    notes : notes of the reader
    """

    reader: str
    program: str = ""
    program_version: str = ""
    clocks: tuple[Clock, ...] = ()
    channels: tuple[Channel, ...] = ()
    markers: MarkerTracks | None = None
    metadata: Mapping[str, object] = field(default_factory=dict)
    notes: tuple[QualityNote, ...] = ()

    def clock(self, name: str) -> Clock:
        """Find a clock by its name.

        Raises
        ------
        KeyError
            If the recording has no such clock.
        """
        return {clock.name: clock for clock in self.clocks}[name]
