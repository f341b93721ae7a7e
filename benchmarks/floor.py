"""The least that processing a test can cost: read it with the libraries, write it back.

As a process of its own: ``python -P floor.py FILTER OUT.json SOURCE ...``. A `SOURCE` is the folder
of a cantilever test, or a ``result.h5``, whose raw group is read. `FILTER` is ``gzip`` for
HDF5's own filters, as in any program that asks for a compressed file; ``isal`` for the same format
deflated by ISA-L, as labpipe's files are; ``none`` for numbers as they are. What is written down is
the cost of each source after the first, if there is more than one.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from isal import isal_zlib

FILTERS = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
CHUNK_BYTES = 1 << 18
NO_CHECKSUM = 4
"""Mask of a chunk that left the third filter, fletcher32, out."""


def exports(test: Path) -> dict[str, np.ndarray]:
    """Time, force and markers of a cantilever test."""
    import pandas as pd
    import scipy.io

    content = scipy.io.loadmat(test / "force.mat", squeeze_me=True, struct_as_record=False)
    recording = next(value for name, value in content.items() if not name.startswith("__"))
    body = pd.read_csv(test / "take.csv", skiprows=6, header=0).to_numpy(dtype=np.float64)
    channels = np.atleast_1d(recording.Y)
    volts = next(channel.Data for channel in channels if "Load Cell" in channel.Path)
    return {"time": recording.X.Data, "force": volts, "markers": body}


def raw_group(result: Path) -> dict[str, np.ndarray]:
    """All arrays of the raw group of a result file."""
    arrays: dict[str, np.ndarray] = {}

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            arrays[name.replace("/", " ")] = item[()]

    with h5py.File(result) as file:
        file["raw"].visititems(take)
    return arrays


def write(arrays: Mapping[str, np.ndarray], path: Path, filtering: str) -> None:
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            if filtering == "isal" and values.size:
                write_deflated(file, name, np.ascontiguousarray(values))
            else:
                options = FILTERS if filtering == "gzip" and values.size else {}
                file.create_dataset(name, data=values, **options)


def write_deflated(file: Any, name: str, values: np.ndarray) -> None:
    """Chunk by chunk through shuffle and ISA-L, on one processor, without a checksum."""
    rows = min(max(CHUNK_BYTES * len(values) // values.nbytes, 1), len(values))
    chunk = (rows, *values.shape[1:])
    options = {"shape": values.shape, "dtype": values.dtype, "chunks": chunk}
    dataset = file.create_dataset(name, **options, **FILTERS)
    for start in range(0, len(values), rows):
        block = np.zeros(chunk, values.dtype)
        block[: len(values) - start] = values[start : start + rows]
        planes = block.view(np.uint8).reshape(-1, values.dtype.itemsize).T
        deflated = isal_zlib.compress(np.ascontiguousarray(planes).data, 1)
        corner = (start,) + (0,) * (values.ndim - 1)
        dataset.id.write_direct_chunk(corner, deflated, NO_CHECKSUM)


def main(filtering: str, out: str, *sources: str) -> None:
    begun, busy = time.perf_counter(), time.process_time()
    for number, source in enumerate(map(Path, sources)):
        if number == 1:
            begun, busy = time.perf_counter(), time.process_time()
        arrays = exports(source) if source.is_dir() else raw_group(source)
        write(arrays, Path(out).with_suffix(".h5"), filtering)
    counted = max(len(sources) - 1, 1)
    wall, cpu = time.perf_counter() - begun, time.process_time() - busy
    cost = {"wall": wall / counted, "cpu": cpu / counted}
    Path(out).write_text(json.dumps(cost), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
