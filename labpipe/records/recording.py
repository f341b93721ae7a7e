"""Define the content of an export (channels with clocks, marker tracks) and the known formats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, NamedTuple

import numpy as np

from labpipe.records.arrays import ArrayRecord, Floats, Unit
from labpipe.records.quality import QualityNote


class ExportFormat(NamedTuple):
    """Format of exports that labpipe reads.

    Parameters
    ----------
    name : name of the format in protocols
    module : module of the reader, which is imported when it is needed
    is_text : whether a file can be a text or a binary file
    is_workbook : whether a file can be a workbook
    has_markers : whether an export contains marker tracks instead of channels
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
    """Time axis of an export, with the times that the export states.

    Parameters
    ----------
    name : name of the axis in the export (a raster, a task), or ``time``
    time : shape (n,), in `unit`, times with the gaps, the jitter and the start of the export
    unit : ``s``; ``1`` if the export has no time, and `time` counts its rows from 0
    """

    name: str
    time: Annotated[Floats, "sample", Unit(unit_field="unit")]
    unit: str = "s"


@dataclass(frozen=True, slots=True, eq=False)
class Channel(ArrayRecord):
    """Named signal of an export, with a unit and a clock.

    Parameters
    ----------
    name : short name, which may occur several times in an export
    path : full name, which is unique in an export, such as ``Model Root/Subsystem/In1``
    values : shape (n,), in `unit`, values of the signal; NaN where the export is blank
    clock : name of the clock of the signal
    unit : SI unit of `values`; None if neither file nor protocol states a unit: `values` are then
        those of the file
    unit_in_file : unit as the export writes it; empty if it states none
    calibration : description of the conversion from the values of the file to `values`; empty if
        they are equal
    """

    name: str
    path: str
    values: Annotated[Floats, "sample", Unit(unit_field="unit")]
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
    rotation : shape (frames, 4), quaternion in the order x, y, z, w; NaN where the body was not
        tracked, or where the export has no rotation
    error : shape (frames,), m, mean error of the markers of the body; NaN where the export has none
    """

    name: str
    position: Annotated[Floats, "frame", "xyz", Unit("m")]
    rotation: Annotated[Floats, "frame", "xyzw", Unit("1")]
    error: Annotated[Floats, "frame", Unit("m")]


@dataclass(frozen=True, slots=True, eq=False)
class MarkerTracks(ArrayRecord):
    """Measured positions of markers and rigid bodies in the frames of a take.

    Parameters
    ----------
    time : shape (frames,), s; frame number / rate if the export states a rate
    frames : shape (frames,), frame numbers of the export
    rate : frames per second, stated by the export or derived from its times
    names : name of each marker, unique in a take; a repeated name is followed by its id
    positions : shape (frames, markers, 3), m, in the frame of the motion-capture system; NaN
        where the marker was not tracked
    bodies : rigid bodies of the take
    unit_in_file : unit of length as the export writes it; empty if it states none
    """

    time: Annotated[Floats, "frame", Unit("s")]
    frames: Annotated[Floats, "frame", Unit("1")]
    rate: float
    names: Annotated[tuple[str, ...], "marker"]
    positions: Annotated[Floats, "frame", "marker", "xyz", Unit("m")]
    bodies: tuple[RigidBody, ...] = ()
    unit_in_file: str = ""

    def find_body(self, name: str) -> RigidBody | None:
        """Find a rigid body by its name; None if the take has no such body."""
        return next((body for body in self.bodies if body.name == name), None)

    @property
    def n_missing(self) -> dict[str, int]:
        """Number of frames in which each marker was not tracked, keyed by marker."""
        counts = np.isnan(self.positions).any(axis=2).sum(axis=0)
        return {name: int(count) for name, count in zip(self.names, counts, strict=True)}


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Content of one export.

    Parameters
    ----------
    reader : name of the reader that read the export
    program, program_version : program that wrote the export; empty if it does not state it
    clocks : time axes of the channels
    channels : signals of the export
    markers : marker tracks of a motion-capture export; None for any other
    metadata : further content of the header, as values that JSON can represent
    notes : quality notes of the reader
    """

    reader: str
    program: str = ""
    program_version: str = ""
    clocks: tuple[Clock, ...] = ()
    channels: tuple[Channel, ...] = ()
    markers: MarkerTracks | None = None
    metadata: Mapping[str, object] = field(default_factory=dict)
    notes: tuple[QualityNote, ...] = ()

    def get_clock(self, name: str) -> Clock:
        """Return the clock with a name.

        Parameters
        ----------
        name : name of the clock

        Raises
        ------
        KeyError
            If the recording has no such clock.
        """
        return {clock.name: clock for clock in self.clocks}[name]
