"""The least that processing a full-size test can cost: read it with the libraries, write it back.

Run as a process of its own: ``python -m benchmarks.floor FORCE.mat TAKE.csv OUT.h5``.
"""

from __future__ import annotations

import sys

import h5py
import numpy as np
import pandas as pd
import scipy.io

FILTERS = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}


def main(force: str, take: str, out: str) -> None:
    recording = next(
        value
        for name, value in scipy.io.loadmat(force, squeeze_me=True, struct_as_record=False).items()
        if not name.startswith("__")
    )
    body = pd.read_csv(take, skiprows=6, header=0).to_numpy(dtype=np.float64)
    with h5py.File(out, "w") as file:
        file.create_dataset("time", data=recording.X.Data, chunks=True, **FILTERS)
        channels = np.atleast_1d(recording.Y)
        volts = next(channel.Data for channel in channels if "Load Cell" in channel.Path)
        file.create_dataset("force", data=volts, chunks=True, **FILTERS)
        file.create_dataset("markers", data=body, chunks=True, **FILTERS)


if __name__ == "__main__":
    main(*sys.argv[1:4])
