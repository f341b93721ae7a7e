"""Write the wire sheet of the virtual wires: what is known of them without a test.

It holds dimensions and materials, and of friction the numbers that the source began with: a
calibration has to find what the tests were made with.
"""

from __future__ import annotations

import csv
from io import StringIO
from math import degrees
from pathlib import Path

from labpipe.virtual_lab.stranded import WIRES, StrandedWire

WIRE_SHEET = "wires.csv"
_HEADS = (
    "wire",
    "wire_diameter_mm",
    "strands",
    "strand_diameter_mm",
    "lay_angles_deg",
    "insulation_thickness_mm",
    "layout",
)


def write_wire_sheet(folder: Path) -> Path:
    """Write the sheet that `labpipe model` and `labpipe calibrate` read.

    Parameters
    ----------
    folder : made if it is not there

    Returns
    -------
    The sheet, with a row for each of `virtual_lab.stranded.WIRES`.
    """
    text = StringIO()
    sheet = csv.writer(text, lineterminator="\n")
    sheet.writerow(_HEADS)
    sheet.writerows(_row(wire) for wire in WIRES.values())
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / WIRE_SHEET
    path.write_text(text.getvalue(), encoding="utf-8")
    return path


def _row(wire: StrandedWire) -> tuple[str, ...]:
    return (
        wire.name,
        f"{1e3 * wire.diameter:.6g}",
        str(wire.n_strands),
        f"{1e3 * wire.strand:.9g}",
        ";".join(f"{degrees(angle):.6g}" for angle in wire.lay_angles),
        f"{1e3 * wire.wall:.6g}",
        "compressed" if wire.is_compressed else "hexagonal",
    )
