"""Reader of dSPACE ControlDesk recordings saved as MDF 4.

**Writes this file**: ControlDesk, "export as MF4".

**Recording**: one channel for each measured variable, one clock for each channel group with a
master channel.

**Units**: those of the channels. No known file has units, so the protocol states them.

**Missing data**: invalid samples and infinities become NaN, with a note. A recording with invalid
times is refused.

**Clock and frame**: the times of the master channel exactly as written, or converted to seconds if
another unit is stated, named after the raster. States are read as their numbers.

**File structure**: MDF 4.10, read by asammdf (the optional extra ``mf4``).

**Known versions**: MDF 4.10 of ControlDesk 7.4.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, redirect_stdout
from functools import partial
from html import unescape
from io import BytesIO, StringIO
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice
from labpipe.readers.controldesk import Axis, Export, Trace, load_export
from labpipe.readers.raw_files import map_read_errors, read_head
from labpipe.records.arrays import Floats
from labpipe.records.recording import Recording

_PROPERTY = re.compile(r'<e name="([^"]*)"[^>]*>(.*?)</e>', re.DOTALL)
_TIME_SYNC_TYPE = 1
"""Type of a master channel of times; others contain angles, distances or indices."""
_ALL_INVALID_FLAG = 1
"""Flag of a channel whose samples are all invalid."""


def recognise(path: Path) -> bool:
    """Return whether a file is an MDF file of version 4, by its first bytes."""
    return read_head(path, 64).startswith(b"MDF     4")


def read(path: Path, *, channels: Sequence[ChannelChoice] | None = None) -> Recording:
    """Read a ControlDesk MF4 file.

    Parameters
    ----------
    path : the export
    channels : names or paths of the wanted channels, None for all

    Returns
    -------
    The recording.

    Raises
    ------
    ReadError
        If asammdf is not installed, the file is damaged, or a wanted channel is missing.
    """
    with _open_file(path) as file:
        return load_export(_parse_groups(file), reader="dspace-mf4", path=path, channels=channels)


@contextmanager
def _open_file(path: Path) -> Iterator[Any]:
    """Open an MDF file without output and warnings of asammdf, and close it at the end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # asammdf warns about its optional parts
        try:
            from asammdf import MDF
        except ImportError as error:
            raise ReadError.about("readers.no_asammdf", path) from error
        logging.getLogger("asammdf").disabled = True  # it logs errors that it also raises
        with (
            map_read_errors(path, "a whole MDF 4 file"),
            redirect_stdout(StringIO()),  # asammdf prints the groups of a damaged file
            closing(_construct_mdf(MDF, path.read_bytes())) as file,
        ):
            yield file


def _construct_mdf(mdf_class: Any, content: bytes) -> Any:
    """Construct the MDF object of a file, or close the partial object of a damaged file.

    Only the traceback refers to the partial object that asammdf (8.8) leaves, and the deletion of
    an open one would print to stderr.
    """
    try:
        return mdf_class(BytesIO(content))
    except Exception as error:
        for frame, _ in walk_tb(error.__traceback__):
            partial_file: Any = frame.f_locals.get("self")
            if hasattr(partial_file, "_mapped_file"):
                partial_file._closed = True
                if getattr(partial_file, "_tempfile", None) is not None:
                    partial_file._tempfile.close()
        raise


def _parse_groups(file: Any) -> Export:
    """Parse the channel groups that have a master, which is their time axis."""
    axes, traces = [], []
    for group_index, group in enumerate(file.groups):
        master = file.masters_db.get(group_index)
        if master is None:
            continue
        axis = group.channels[master]
        unit = axis.unit if axis.sync_type == _TIME_SYNC_TYPE else "no time"
        axes.append(Axis(axis.name, unit, _build_loader(file, group_index, master)))
        traces += [
            Trace(
                name=channel.name.rsplit("/", 1)[-1],
                path=channel.name,
                unit_in_file=channel.unit or "",
                axis_index=len(axes) - 1,
                load=_build_loader(file, group_index, index),
                properties={"comment": channel.comment or ""},
            )
            for index, channel in enumerate(group.channels)
            if index != master
        ]
    header = file.header
    properties = {key: unescape(value) for key, value in _PROPERTY.findall(header.comment or "")}
    return Export(
        axes=axes,
        traces=traces,
        origin=properties.get("Origin", ""),
        metadata={"mdf": file.version, "start_time": header.start_time.isoformat(), **properties},
    )


def _build_loader(file: Any, group_index: int, index: int) -> Callable[[], Floats]:
    """Build a function that loads the samples of a channel."""
    max_record_bytes = 1 << 24

    def load() -> Floats:
        group = file.groups[group_index]
        channel, record = group.channels[index], group.channel_group
        size, invalidation_size = record.samples_byte_nr, record.invalidation_bytes_nr
        end_bit = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
        # asammdf (8.8) would read beyond the record, or allocate gigabytes for one record.
        if end_bit > 8 * size or size + invalidation_size > max_record_bytes:
            message = f"channel {index} needs {end_bit} bits of a record of {size} bytes"
            raise ValueError(message)
        # By default asammdf leaves out invalid samples, which separates the channel from its clock.
        get = partial(file.get, group=group_index, index=index, ignore_invalidation_bits=True)
        signal = get()
        if signal.samples.dtype.kind in "SU":  # names of states, whose numbers are the raw samples
            signal = get(raw=True)
        is_invalid = np.asarray(signal.invalidation_bits, dtype=bool)  # None becomes False
        is_invalid = is_invalid | bool(channel.flags & _ALL_INVALID_FLAG)
        return np.where(is_invalid, np.nan, np.asarray(signal.samples, dtype=np.float64))

    return load
