"""Data sets of HDF5 whose samples other files hold, or none."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

WAYS = ("link", "virtual", "external", "sparse", "sparse in chunks")


def move_elsewhere(group: h5py.Group, name: str, how: str) -> None:
    """Put another data set in the place of one, with its attributes."""
    old = group[name]
    labels, shape, kind = dict(old.attrs), old.shape, old.dtype
    other = Path(group.file.filename).with_name("other.h5")
    with h5py.File(other, "w") as file:
        file["secret"] = np.zeros(shape)
    del group[name]
    if how == "link":
        group[name] = h5py.ExternalLink(str(other), "secret")
        return
    if how == "virtual":
        layout = h5py.VirtualLayout(shape=shape, dtype=kind)
        layout[:] = h5py.VirtualSource(str(other), "secret", shape=shape)
        group.create_virtual_dataset(name, layout)
    elif how == "external":
        group.create_dataset(name, shape=shape, dtype=kind, external=[(other, 0, 10**6)])
    else:
        most = (*(1 for _ in shape[1:]), 10**13)
        chunks = (*(1 for _ in shape[1:]), 1 << 15) if "chunks" in how else None
        group.create_dataset(name, shape=most, dtype=kind, chunks=chunks)
    group[name].attrs.update(labels)
