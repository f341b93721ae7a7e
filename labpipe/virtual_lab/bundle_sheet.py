"""What a test sheet says of a bundle: the words that a person at the bench would write."""

from __future__ import annotations

from collections.abc import Iterator

from labpipe.records.bundle import NONE
from labpipe.virtual_lab.bundles import BundleModel, lay_wires
from labpipe.virtual_lab.stranded import WIRES


def bundle_lines(bundle: BundleModel) -> Iterator[str]:
    """Word the block ``bundle`` of a specimen, indented as it stands in the sheet.

    Parameters
    ----------
    bundle : what it is made of. Where the wires lie is said of mixed bundles, whose wires somebody
        has laid on purpose
    """
    yield "  bundle:"
    wires = ", ".join(
        f"{name}: {{number: {number}, diameter: {_millimetres(WIRES[name].diameter)}}}"
        for name, number in bundle.wires
    )
    yield f"    wires: {{{wires}}}"
    yield f"    number: {bundle.number}"
    yield f"    arrangement: {bundle.arrangement}"
    if len(bundle.wires) > 1:
        yield "    positions:"
        layout = lay_wires(bundle)
        for x, y in zip(layout.x.tolist(), layout.y.tolist(), strict=True):
            yield f"      - [{1e3 * x:.4f} mm, {1e3 * y:.4f} mm]"
    for key in ("tape", "taping", "conduit"):
        if getattr(bundle, key) != NONE:
            yield f"    {key}: {getattr(bundle, key)}"
    if bundle.conduit_bore is not None:
        yield f"    conduit_bore: {_millimetres(bundle.conduit_bore)}"


def _millimetres(length: float) -> str:
    return f"{1e3 * length:.10g} mm"
