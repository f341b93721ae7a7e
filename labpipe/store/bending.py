"""Measured moment-curvature as a group of the file, the cloud and the law: both ways."""

from __future__ import annotations

from typing import Any

import numpy as np

from labpipe.records.bending import Bending, BendingCloud, MeasuredLaw
from labpipe.store import layout
from labpipe.store.checked import array, arrays
from labpipe.store.chunks import Target
from labpipe.store.reasons import read_reasons, write_reasons


def write_bending(target: Target, bending: Bending) -> None:
    """Write cloud and law.

    Parameters
    ----------
    target : their group, empty
    bending : what was measured
    """
    target.fields(bending.cloud, layout.CLOUD_FIELDS)
    target.group.attrs["frames_per_mean"] = int(bending.cloud.frames_per_mean)
    write_reasons(target, [bending.reason] if bending.reason else [])
    if bending.law is not None:
        _write_law(target.inside(layout.LAW), bending.law)


def _write_law(target: Target, law: MeasuredLaw) -> None:
    target.fields(law, layout.LAW_FIELDS)
    target.array(layout.IS_KNOWN, law.is_known.astype(np.uint8), layout.KNOWN)
    for name, unit in layout.LAW_UNITS.items():
        target.group.attrs[name] = float(getattr(law, name))
        target.group.attrs[f"{name}_unit"] = unit
    target.group.attrs["n_frames"] = int(law.n_frames)
    write_reasons(target, [law.reason] if law.reason else [])


def read_bending(group: Any) -> Bending:
    """Read cloud and law.

    Parameters
    ----------
    group : open HDF5 group that `write_bending` made

    Returns
    -------
    What was measured.
    """
    return Bending(
        cloud=BendingCloud(
            **arrays(group, layout.CLOUD_FIELDS),
            frames_per_mean=int(group.attrs["frames_per_mean"]),
        ),
        law=_law(group[layout.LAW]) if layout.LAW in group else None,
        reason=next(iter(read_reasons(group)), None),
    )


def _law(group: Any) -> MeasuredLaw:
    fields: dict[str, Any] = {
        **arrays(group, layout.LAW_FIELDS),
        **{name: float(group.attrs[name]) for name in layout.LAW_UNITS},
    }
    return MeasuredLaw(
        **fields,
        is_known=array(group, layout.IS_KNOWN, layout.KNOWN).astype(np.bool_),
        n_frames=int(group.attrs["n_frames"]),
        reason=next(iter(read_reasons(group)), None),
    )
