"""What was tested as a group of the file, with the bundle that it may be: both ways."""

from __future__ import annotations

from math import isnan, nan
from typing import Any

import numpy as np

from labpipe.records.bundle import ARRANGEMENTS, TAPINGS, Bundle, BundleWire
from labpipe.records.result import Specimen
from labpipe.store import layout
from labpipe.store.checked import array, strings, text, texts
from labpipe.store.chunks import Target


def write_specimen(target: Target, specimen: Specimen) -> None:
    """Write dimensions, labels and bundle.

    Parameters
    ----------
    target : their group, empty
    specimen : what was tested; type, spool and sample are attributes of the root
    """
    target.texts("dimensions", tuple(specimen.dimensions))
    target.group.attrs["values"] = np.array(list(specimen.dimensions.values()), dtype=float)
    target.group.attrs["unit"] = "m"
    if specimen.labels:
        target.texts(layout.LABELS, tuple(specimen.labels))
        target.texts(layout.LABEL_WORDS, tuple(specimen.labels.values()))
    if specimen.bundle is not None:
        _write_bundle(target.inside(layout.BUNDLE), specimen.bundle)


def _write_bundle(target: Target, bundle: Bundle) -> None:
    for name in layout.BUNDLE_TEXTS:
        target.group.attrs[name] = getattr(bundle, name)
    target.group.attrs[layout.BORE] = _number(bundle.conduit_bore)
    target.group.attrs[f"{layout.BORE}_unit"] = "m"
    numbers = np.array([wire.number for wire in bundle.wires], dtype=np.int64)
    diameters = np.array([_number(wire.diameter) for wire in bundle.wires])
    target.strings(layout.WIRE_TYPES, tuple(wire.type for wire in bundle.wires), "type")
    target.array(layout.WIRE_NUMBERS, numbers, layout.WIRE_NUMBER)
    target.array(layout.WIRE_DIAMETERS, diameters, layout.WIRE_DIAMETER)
    if bundle.positions:
        target.array(layout.POSITIONS, np.array(bundle.positions), layout.WIRE_POSITION)


def read_specimen(root: Any) -> Specimen:
    """Read what was tested.

    Parameters
    ----------
    root : open result file; one from before there were bundles and labels has none

    Returns
    -------
    The specimen.
    """
    named = {name: text(root, where) for name, where in layout.SPECIMEN_TEXTS.items()}
    group = root[layout.SPECIMEN]
    values = (float(value) for value in group.attrs["values"])
    dimensions = dict(zip(texts(group, "dimensions"), values, strict=True))
    bundle = _bundle(group[layout.BUNDLE]) if layout.BUNDLE in group else None
    nested = named["type"], named["spool"], named["sample"]
    return Specimen(*nested, dimensions, bundle, _labels(group))


def _labels(group: Any) -> dict[str, str]:
    if layout.LABELS not in group.attrs:
        return {}
    return dict(zip(texts(group, layout.LABELS), texts(group, layout.LABEL_WORDS), strict=True))


def _bundle(group: Any) -> Bundle:
    wires = zip(
        strings(group, layout.WIRE_TYPES, "type"),
        array(group, layout.WIRE_NUMBERS, layout.WIRE_NUMBER),
        array(group, layout.WIRE_DIAMETERS, layout.WIRE_DIAMETER),
        strict=True,
    )
    given = layout.POSITIONS in group
    positions = array(group, layout.POSITIONS, layout.WIRE_POSITION) if given else ()
    return Bundle(
        wires=tuple(BundleWire(kind, int(number), _known(wide)) for kind, number, wide in wires),
        arrangement=_one_of(ARRANGEMENTS, text(group, "arrangement")),
        positions=tuple((float(x), float(y)) for x, y in positions),
        tape=text(group, "tape"),
        taping=_one_of(TAPINGS, text(group, "taping")),
        conduit=text(group, "conduit"),
        conduit_bore=_known(group.attrs[layout.BORE]),
    )


def _one_of(known: tuple[str, ...], word: str) -> str:
    if word not in known:
        message = f"{word!r} is none of {', '.join(known)}"
        raise ValueError(message)
    return word


def _number(value: float | None) -> float:
    return nan if value is None else value


def _known(value: float) -> float | None:
    return None if isnan(value) else float(value)
