"""Harness YAMLs for tests: small lines that are followed in a moment."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import Material, prepare_line, read_material
from labpipe.protocol.load import load_harness
from labpipe.protocol.model_files import HarnessFile

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SHEET = EXAMPLES / "wires.xlsx"
"""The wire sheet of the examples, whose wires are real ones."""
STIFFNESS = (
    "{bending_stiffness: 150 N*mm^2, torsional_stiffness: 120 N*mm^2, largest_curvature: 80 1/m, "
    "diameter: 2 mm, mass_per_length: 7 g/m}"
)
WIRE = "{wire: A2}"
SLACK = (EXAMPLES / "harness-slack.yaml").read_text(encoding="utf-8")


def arch(section: str = STIFFNESS, *, steps: int = 8, more: str = "", line: str = "") -> str:
    """A line of 200 mm whose end is brought 20 mm nearer and 30 mm upwards.

    Parameters
    ----------
    section : what the line is made of
    steps : of the harness
    more : keys of the file
    line : keys of the line
    """
    return f"""\
version: 1
about: brought nearer
line:
  length: 200 mm
  elements: 16
  section: {section}
{line}boundaries:
  - {{kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm], direction: [1, 0, 0]}}
  - {{kind: clip, name: right, at: end, position: [180 mm, 0 mm, 30 mm], direction: [1, 0, 0]}}
steps: {steps}
{more}"""


def pushed(section: str = WIRE) -> str:
    """A cantilever that a gripper lifts and lets go.

    Parameters
    ----------
    section : what the line is made of
    """
    return f"""\
version: 1
line: {{length: 100 mm, elements: 12, section: {section}}}
boundaries:
  - {{kind: clip, name: bench, at: start, position: [0 mm, 0 mm, 0 mm], direction: [1, 0, 0]}}
  - kind: grip
    name: gripper
    at: 80 mm
    holds: position
    path: [{{step: 2, position: [79 mm, 0 mm, 10 mm]}}, {{step: 8, position: [60 mm, 0 mm, 45 mm]}}]
    release: 9
steps: 10
show: [8]
"""


def written(folder: Path, text: str, name: str = "line.yaml") -> Path:
    """Write a harness YAML into a folder that has the wire sheet beside it.

    Parameters
    ----------
    folder : that is there
    text : of the file
    name : of the file
    """
    sheet = folder / "wires.xlsx"
    if not sheet.exists():
        sheet.write_bytes(SHEET.read_bytes())
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


class Followed(NamedTuple):
    """A harness YAML and what its line does."""

    harness: HarnessFile
    material: Material
    path: RodPath


@cache
def followed(text: str, **inputs: float) -> Followed:
    """Follow the line of a harness YAML at the best of its inputs, once for each text.

    Parameters
    ----------
    text : of the file
    inputs : others than the best ones, such as an `isotropic_share`
    """
    with TemporaryDirectory() as folder:
        file = written(Path(folder), text)
        harness = load_harness(file)
        material = read_material(harness, file)
    best = {**material.best_inputs, **inputs}
    prepared = prepare_line(harness, material.sections[0](best), best)
    path = follow(*prepared, steps=harness.steps)
    return Followed(harness, material, path)
