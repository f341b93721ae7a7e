"""The real exports, opened with pandas and h5py alone: which columns of which rows are a test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.judges.plain.definitions import Record, Samples
from tests.judges.plain.numbers import USUAL, Asked
from tests.judges.plain.shapes import NEWTON

LLOYD = "lloyd_nexygen/"
REU = "mts/REU/"
TIMED = "DAQ- Crosshead, … - (Timed)"
RUN = f"mts/MTS_data/I0-0.9-dc/Test Run 4 10-23-2023 6 43 09 PM/{TIMED}"
FDA = "mts/FDA/C18-L-M-RF 10-26-2022 1 03 54 PM/Collect Data - (Timed).txt"
METRE = {"mm": 1e-3, "um": 1e-6, "in": 0.0254}


@dataclass(frozen=True)
class Columns:
    """Where time, travel and force stand in a table of text, counted from 0."""

    travel: int
    force: int
    time: int | None = None
    skip: int = 1
    """Lines before the first sample."""
    last: int | None = None
    """Number of samples, if lines follow that are none."""
    separator: str = "\t"
    decimal: str = "."
    encoding: str = "utf-8-sig"
    sheet: str = ""
    """Of a workbook."""


@dataclass(frozen=True)
class Real:
    """One test: its files, where its numbers stand, and what labpipe is asked by YAML."""

    files: tuple[str, ...]
    columns: Columns
    force: str
    """Name of the channel in the export."""
    travel: str
    units: tuple[str, str] = ("N", "mm")
    minutes: bool = False
    asked: Asked = USUAL
    hurt: Mapping[str, str] = field(default_factory=dict)
    sign_free: bool = False
    refusal: str = ""
    part: str = ""
    since: float = 0.0
    """s, from which on the file holds the test; before that its operator set zeros."""


def read(real: Real, root: Path) -> Record:
    """Rows of all files in the order of their times; NaN where a cell is blank."""
    tables = [_table(root / name, real.columns) for name in real.files if _filled(root / name)]
    table = np.concatenate(sorted(tables, key=lambda each: float(each[0, -1])))
    time = None if real.columns.time is None else table[:, 2] * (60.0 if real.minutes else 1.0)
    newton, metre = NEWTON[real.units[0]], METRE[real.units[1]]
    late = slice(0 if time is None else int(np.searchsorted(time, real.since)), None)
    kept = None if time is None else time[late]
    return Record(kept, metre * table[late, 0], newton * table[late, 1])


def _filled(path: Path) -> bool:
    """TestSuite leaves a file with three bytes for a step that took no samples."""
    return path.stat().st_size > 3


@cache
def _table(path: Path, columns: Columns) -> Samples:
    """Travel, force and, if there is one, time."""
    wanted = [columns.travel, columns.force, *([] if columns.time is None else [columns.time])]
    if columns.sheet:
        frame = pd.read_excel(
            path, sheet_name=columns.sheet, header=None, skiprows=columns.skip, engine="calamine"
        )
    else:
        frame = pd.read_csv(
            path,
            sep=columns.separator,
            header=None,
            skiprows=columns.skip,
            nrows=columns.last,
            decimal=columns.decimal,
            encoding=columns.encoding,
            usecols=wanted,
        )
    return frame[wanted].to_numpy(dtype=float)


def controldesk(path: Path) -> dict[str, Samples]:
    """Time ("") and channels by full path of a MAT file of ControlDesk, v5 or v7.3."""
    import h5py
    import scipy.io

    if not h5py.is_hdf5(path):
        content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
        (data,) = (each for name, each in content.items() if not name.startswith("_"))
        found = {f"{each.Path}/{each.Name}": each.Data for each in data.Y}
        return {"": data.X.Data, **found}
    with h5py.File(path) as file:
        (group,) = (file[name] for name in file if not name.startswith("#"))

        def text(reference: Any) -> str:
            return "".join(map(chr, file[reference][:].ravel())).replace(r"\n", "")

        rows = zip(*(group["Y"][key][:, 0] for key in ("Path", "Name", "Data")), strict=True)
        found = {f"{text(a)}/{text(b)}": file[data][:].ravel() for a, b, data in rows}
        return {"": group["X"]["Data"][:].ravel(), **found}


def lloyd(name: str, low: float, high: float, **more: Any) -> Real:
    columns = Columns(1, 0, encoding="utf-16")
    return Real(
        (f"{LLOYD}tensile_{name}.txt",),
        columns,
        "Load",
        "Machine Extension",
        asked=Asked((low, high), 0.2),
        **more,
    )


def bent(name: str, encoding: str = "utf-16-le") -> Real:
    """Load and travel are blank in other rows, so that what is there at the ends is not known."""
    return Real(
        (f"{LLOYD}3pb_hm3_{name}.txt",),
        Columns(2, 1, 0, encoding=encoding),
        "Load",
        "Machine Extension",
        asked=Asked((0.2, 3.2), 0.2, segments=True),
        hurt={
            "peak_*": "missing",
            "energy*": "missing|no_break|no_failure",
            "failure*": "missing|no_break|no_failure",
        },
    )


def suite(
    file: str,
    window: tuple[float, float],
    unit: str,
    columns: Columns,
    *,
    slack: bool = False,
    hurt: Mapping[str, str] | None = None,
) -> Real:
    asked, units = Asked(window, 0.2, slack=slack), (unit, "mm")
    return Real((file,), columns, "Load", "Crosshead", units, asked=asked, hurt=hurt or {})


BENT = (
    *("1_test1", "1_test2", "1_test3", "1b_test1", "2_test1", "3_test1", "4_test1"),
    *("5_test1", "5_test2", "5_test3", "6_test1", "7_test1", "7_test2", "7_test3"),
)
CSV = Columns(0, 1, 2, skip=8, separator=",")
YARN = "zwick/yarn_compressionTests.xls"
SIGN = "sign|negative|reversed|down|compress"

FRAMES: dict[str, Real] = {
    "copper-1": lloyd("22awg_copper_1_50mm", 0.5, 3.0),
    "copper-1a": lloyd("22awg_copper_1a_50mm", 0.5, 3.0),
    "copper-2": lloyd("22awg_copper_2_50mm", 0.5, 3.0),
    "silicone-1": lloyd("22awg_silicone_1_50mm", 5.0, 60.0),
    "silicone-2": lloyd("22awg_silicone_2_50mm", 5.0, 60.0),
    "latex": lloyd("latex_1_30.5mm", 10.0, 60.0),
    **{f"bent-{name}": bent(name, "utf-16" if name == "7_test1" else "utf-16-le") for name in BENT},
    "cable-ld": suite(f"{REU}SteelCableLD_200mm_Trial3/{TIMED}.csv", (0.5, 1.0), "kN", CSV),
    "cable-sd": suite(f"{REU}SteelCableSD_100mm_Trial1/{TIMED}.csv", (0.5, 1.0), "kN", CSV),
    **{
        f"{name}-slack": suite(f"{REU}{folder}/{TIMED}.csv", (0.3, 0.8), "kN", CSV, slack=True)
        for name, folder in (
            ("cable-ld", "SteelCableLD_200mm_Trial3"),
            ("cable-sd", "SteelCableSD_100mm_Trial1"),
        )
    },
    "cable-cycles": suite(
        f"{REU}Hysteresis_SteelCableSD_Trial1/{TIMED}.csv",
        (0.2, 0.5),
        "kN",
        Columns(1, 2, 3, skip=8, separator=","),
    ),
    "ym-extract": suite(f"mts/ym-extract/{TIMED}.txt", (5.0, 20.0), "N", Columns(0, 1, 2, skip=8)),
    "bone": Real(
        (FDA,),
        Columns(0, 1, 4, skip=8),
        "Ch 1 Force",
        "Ch 1 Displacement",
        ("kN", "mm"),
        asked=Asked((0.1, 0.2), 0.05),
        sign_free=True,
        hurt={"*": SIGN},
    ),
    "doubly-compressed": Real(
        tuple(f"{RUN}{number}.txt" for number in ("", "1", "2", "3", "4", "5")),
        Columns(0, 1, 2, skip=8),
        "Load",
        "Crosshead",
        asked=Asked(None, 0.1),
    ),
    "flexure-793": Real(
        ("mts/mts793/1_3D850_s1.dat",),
        Columns(0, 1, 2, skip=8, separator=r"\s+"),
        "Ch 1 Force",
        "Ch 1 Displacement",
        ("kN", "mm"),
        asked=Asked((1.0, 2.0), 0.2),
        sign_free=True,
        hurt={"*": SIGN},
    ),
    "crush-793": Real(
        ("mts/mts793/bam_druck_Wolf_8.2_Probe_2_specimen.dat",),
        Columns(5, 4, 2, skip=21, decimal=",", encoding="cp1252"),
        "Ch 1 Kraft",
        "Ch 1 Weg",
        ("kN", "mm"),
        asked=Asked((0.3, 0.8), 0.2),
        sign_free=True,
        hurt={"*": SIGN},
    ),
    "modulus-793": Real(
        ("mts/mts793/bam_emodul_specimen.dat",),
        Columns(4, 3, 1, skip=15, last=572, decimal=",", encoding="cp1252"),
        "Ch 1 Kraft",
        "Ch 1 Weg",
        ("kN", "mm"),
        asked=Asked((0.1, 0.3), 0.1),
        sign_free=True,
        since=45.0,
        hurt={"*": f"{SIGN}|zero|jump|drift|tare|not_reached"},
    ),
    "aluminium": Real(
        ("instron/bezborodow_Al5005.csv",),
        Columns(1, 2, 0, skip=14, separator=","),
        "Load",
        "Extension",
        asked=Asked((0.1, 0.5), 0.2),
    ),
    "steel-8852": Real(
        ("instron/matolab_instron8852_example2.csv",),
        Columns(0, 1, 8, skip=2),
        "Kraft",
        "Maschine",
        ("kN", "mm"),
        asked=Asked((0.1, 0.4), 0.2),
    ),
    "flexure-bluehill": Real(
        ("instron/nosh_3pb_Specimen_RawData_1.csv",),
        Columns(1, 2, 0, skip=6, separator=","),
        "Load",
        "Extension",
        ("lbf", "in"),
        asked=Asked((20.0, 25.0), 0.2),
        hurt={"*": "under_load|begins|start|zero"},
    ),
    "elastomer-cycle": Real(
        ("instron/vhb4910_0d05_2d0_gbk.csv",),
        Columns(1, 2, 0, skip=3, separator=",", encoding="gbk"),
        "力",
        "位移",
        asked=Asked((5.0, 40.0), 1.0),
    ),
    "elastomer-hold": Real(
        ("instron/vhb4910_relax_5d0_utf8.csv",),
        Columns(1, 2, 0, skip=2, separator=","),
        "力",
        "位移",
        asked=Asked((20.0, 200.0), 1.0),
    ),
    "alloy-tra": Real(
        ("zwick/Allong 1.TRA",),
        Columns(3, 2, 0, skip=12, separator=",", encoding="cp1252"),
        "Force standard",
        "Course standard",
        asked=Asked((0.05, 0.15), 0.05),
        hurt={"*": "under_load|begins|start|zero|drift|jump|negative"},
    ),
    "etfe-tra": Real(
        ("zwick/Zugversuch_eng_ETFE-Ref+Groesseneffekt6.TRA",),
        Columns(1, 2, 0, skip=18, encoding="cp1252"),
        "Standardkraft",
        "Standardweg",
        asked=Asked((1.0, 4.0), 0.2),
    ),
    "metal-xlsx": Real(
        ("zwick/FSP_AB_1_Traction-11.XLSX",),
        Columns(3, 1, 0, skip=3, sheet="Values FSP_As-FSP_01"),
        "Standard force",
        "Standard travel",
        asked=Asked((0.05, 0.15), 0.05),
    ),
    "aborted-xlsx": Real(
        ("zwick/Target-2.XLSX",),
        Columns(4, 3, 0, skip=3, sheet="Values Specimen 2"),
        "Standard force",
        "Standard travel",
        refusal="samples|time",
    ),
    **{
        name: Real(
            (YARN,),
            Columns(2, 1, 0, skip=3, sheet=name),
            "Standard force",
            "Strain",
            ("mN", "mm"),
            asked=Asked((0.5, 1.5), 0.2),
            part=name,
        )
        for name in (*(f"cotton-{i}" for i in range(1, 5)), *(f"acrylic-{i}" for i in range(1, 4)))
    },
    "shimadzu": Real(
        ("shimadzu/Exemple_Shimadzu_Tract_L100_D2.csv",),
        Columns(2, 1, 0, skip=3, separator=","),
        "Force",
        "Stroke",
        asked=Asked((0.5, 1.0), 0.2),
    ),
    "walter-bai-100": Real(
        ("walter_bai/Exemple_WB100kN_Tract_L100_D2.csv",),
        Columns(9, 2, 1, separator=";"),
        "C_1_Force",
        "C_1_Déplacement",
        ("kN", "mm"),
        asked=Asked((0.5, 1.5), 0.2),
    ),
    "walter-bai-400": Real(
        ("walter_bai/Exemple_WB400kN_2_Tract_L100_D10.csv",),
        Columns(1, 2, separator=",", encoding="cp1252"),
        "Force",
        "Déplacement",
        asked=Asked((3.0, 5.0), 0.2),
        hurt={"*": "under_load|begins|start|zero"},
    ),
    "hot-catman": Real(
        ("hbm_catman/DD11_7_1.ASC",),
        Columns(3, 2, 0, encoding="cp1252"),
        "Kraft",
        "Standardwegaufnehmer",
        asked=Asked((1.0, 1.5), 0.2),
        hurt={"*": "under_load|begins|start|zero|drift|jump|negative"},
    ),
    "cellulose-microtest": Real(
        ("deben/NANOCEL_KW.CHAL_450PPM_15.MTR",),
        Columns(1, 2, 0, skip=20, separator=",", last=2701),
        "Force",
        "Elongation",
        asked=Asked((0.1, 0.3), 0.05),
    ),
    "cellulose-dma": Real(
        ("ta_dma/BC100GLU_01.txt",),
        Columns(2, 3, 0, skip=56, encoding="utf-16"),
        "Static Force",
        "Displacement",
        ("N", "um"),
        minutes=True,
        asked=Asked((0.05, 0.15), 0.02),
    ),
}
