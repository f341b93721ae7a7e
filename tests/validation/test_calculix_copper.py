"""Copper that hardens isotropically in part, on one brick of CalculiX, pulled and pushed back.

Bricks that share their nodes are laminae of one material: one that hardens isotropically holds the
isotropic share, perfectly plastic ones and an elastic one are Masing's sliders. A Poisson's ratio
of 0.49 makes elastic laminae contract as plastic ones do.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.law.sliders import (
    SliderLaw,
    make_growing_slider,
    make_unbent_history,
    slide,
    split_hardening,
)
from labpipe.records.arrays import Floats

pytestmark = pytest.mark.skipif(shutil.which("ccx") is None, reason="ccx is not installed")

MODULUS = 110e9
STRAIN: Floats = np.array([0.2, 0.4, 0.8, 1.5, 2.5, 4.0, 8.0]) * 1e-3
SLOPES: Floats = MODULUS * np.array([1.0, 0.55, 0.3, 0.16, 0.09, 0.05, 0.03])
STRESS: Floats = np.cumsum(SLOPES * np.diff(STRAIN, prepend=0.0))
TURNS = (0.003, 0.0005, 0.004, 0.0)
STEPS = 40
PATH: Floats = np.concatenate(
    [np.linspace(a, b, STEPS + 1)[1:] for a, b in zip((0.0, *TURNS), TURNS, strict=False)]
)
CORNERS = "000 100 110 010 001 101 111 011"
FACES = {"X0": "1, 4, 5, 8", "Y0": "1, 2, 5, 6", "Z0": "1, 2, 3, 4", "X1": "2, 3, 6, 7"}

Points = list[tuple[float, float]]


def law_of(share: float) -> SliderLaw:
    """The material as sliders, strains in place of curvatures."""
    masing = SliderLaw(SLOPES[-1], -np.diff(SLOPES), STRAIN[:-1], 0.0, STRAIN[-1])
    return split_hardening(masing, make_growing_slider(STRAIN, STRESS, 1.0), share)


def stresses_of(law: SliderLaw) -> Floats:
    rests, stresses = make_unbent_history(law, 1), []
    for strain in PATH:
        step = slide(law, np.array([strain]), rests)
        rests = step.history
        stresses.append(step.moment[0])
    return np.array(stresses)


def material(*keywords: tuple[str, Points], modulus: float, poisson: float) -> list[str]:
    lines = ["*ELASTIC", f"{modulus:.9g}, {poisson}"]
    for keyword, points in keywords:
        lines += [keyword, *(f"{stress:.9g}, {strain:.9g}" for stress, strain in points)]
    return lines


def laminae(law: SliderLaw) -> list[list[str]]:
    parts = [
        material(("*PLASTIC", [(k * e, 0.0), (1.0001 * k * e, 1.0)]), modulus=k, poisson=0.49)
        for k, e in zip(law.slider_stiffnesses, law.slip_curvatures, strict=True)
    ]
    for slider in law.growing_sliders:
        # Beyond its table, the program would harden no more.
        slid = np.append(slider.slid_curvatures, 0.1)
        points = list(zip(slider.compute_limit(slid), slid, strict=True))
        parts.append(material(("*PLASTIC", points), modulus=slider.stiffness, poisson=0.49))
    spring = law.spring_stiffness  # none with an isotropic share of 1
    return [*parts, material(modulus=spring, poisson=0.49)] if spring > 0.0 else parts


def pulled(folder: Path, materials: list[list[str]], *, step: str = "*STEP") -> Floats:
    """Forces on the brick along the path, N, as the program finds them."""
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{n}, {', '.join(at)}" for n, at in enumerate(CORNERS.split(), start=1)]
    for number, one in enumerate(materials, start=1):
        lines += [f"*ELEMENT, TYPE=C3D8, ELSET=E{number}", f"{number}, 1, 2, 3, 4, 5, 6, 7, 8"]
        lines += [f"*MATERIAL, NAME=M{number}", *one]
        lines += [f"*SOLID SECTION, ELSET=E{number}, MATERIAL=M{number}"]
    for name, nodes in FACES.items():
        lines += [f"*NSET, NSET={name}", nodes]
    lines += ["*BOUNDARY", "X0, 1", "Y0, 2", "Z0, 3", "*AMPLITUDE, NAME=PATH", "0., 0."]
    lines += [f"{time}., {strain}" for time, strain in enumerate(TURNS, start=1)]
    lines += [f"{step}, INC=1000", "*STATIC", f"{1 / STEPS}, {len(TURNS)}., 1e-8, {1 / STEPS}"]
    lines += ["*BOUNDARY, AMPLITUDE=PATH", "X1, 1, 1, 1."]
    lines += ["*NODE PRINT, NSET=X1, TOTALS=ONLY", "RF", "*END STEP"]
    (folder / "brick.inp").write_text("\n".join(lines) + "\n")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run(["ccx", "-i", "brick"], cwd=folder, env=environment, check=True, timeout=120)
    rows = [line.split() for line in (folder / "brick.dat").read_text().splitlines()]
    return np.array([float(row[0]) for row in rows if len(row) == 3])


@pytest.mark.parametrize("share", [0.0, 0.35, 0.5, 1.0])
def test_laminae_unload_as_the_law_does(share: float, tmp_path: Path) -> None:
    law = law_of(share)
    expected = stresses_of(law)
    assert expected[:STEPS] == pytest.approx(
        np.interp(PATH[:STEPS], np.append(0.0, STRAIN), np.append(0.0, STRESS))
    )
    forces = pulled(tmp_path, laminae(law))
    assert np.max(np.abs(forces - expected)) < 0.003 * expected.max()


def test_combined_hardening_is_not_the_law(tmp_path: Path) -> None:
    """One yield surface: right on first loading, with NLGEOM; wrong once it yields backwards."""
    share, first = 0.5, STRESS[0]
    plastic = STRAIN - STRESS / MODULUS
    tables = [
        (keyword, list(zip(first + part * (STRESS - first), plastic, strict=True)))
        for keyword, part in (
            ("*PLASTIC, HARDENING=COMBINED", 1.0 - share),
            ("*CYCLIC HARDENING", share),
        )
    ]
    one = material(*tables, modulus=MODULUS, poisson=0.3)
    expected = stresses_of(law_of(share))
    forces = pulled(tmp_path, [one], step="*STEP, NLGEOM")
    off = np.abs(forces - expected) / expected.max()
    assert np.max(off[:STEPS]) < 0.02
    assert 0.3 < np.max(off[STEPS : 2 * STEPS]) < 0.5
    small = pulled(tmp_path, [one])
    assert small[STEPS - 1] < 0.6 * expected[STEPS - 1]
