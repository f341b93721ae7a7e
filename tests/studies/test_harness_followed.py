"""A harness as followed: status, reasons, steps that are shown, lengths of a sweep."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProcessingError
from labpipe.protocol.load import load_harness
from labpipe.records.result import Status
from labpipe.studies.harness_followed import FollowedHarness, followed, shown_steps, swept
from labpipe.studies.harness_section import material_of
from tests.builders.harness_files import STIFFNESS, arch, pushed, written


def run(folder: Path, text: str, limit: float | None = None) -> FollowedHarness:
    file = written(folder, text)
    harness = load_harness(file)
    material = material_of(harness, file)
    material = material if limit is None else replace(material, limit=limit)
    return followed(harness, file, material, folder / "out")


@pytest.mark.slow
def test_a_line_within_its_law_is_ok(tmp_path: Path) -> None:
    found = run(tmp_path, arch())
    assert (found.status, found.reasons, found.bands) == (Status.OK, (), None)
    assert found.steps == (8,)
    assert {each.status for each in found.results if each.value is not None} == {Status.OK}
    assert found.sharpest.radius <= found.results[0].value  # type: ignore[operator]
    assert not (tmp_path / "out").exists(), "nothing is written here"


@pytest.mark.slow
def test_one_beyond_it_is_doubtful_with_all_its_numbers(tmp_path: Path) -> None:
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    for text in (arch(), arch(section)):
        found = run(tmp_path, text, limit=2.0)
        assert found.status is Status.DOUBTFUL
        assert [each.code for each in found.reasons] == ["beyond_backed"], "said once"
        assert {each.status for each in found.results} == {Status.DOUBTFUL}
    assert found.bands is not None


@pytest.mark.slow
def test_one_beyond_the_range_of_its_law_says_so(tmp_path: Path) -> None:
    found = run(tmp_path, arch(STIFFNESS.replace("80 1/m", "5 1/m")))
    assert found.status is Status.DOUBTFUL
    assert [each.code for each in found.reasons] == ["beyond_law"]
    assert "step" in found.reasons[0].message


@pytest.mark.slow
def test_steps_and_lengths(tmp_path: Path) -> None:
    file = written(tmp_path, arch(more="show: [6, 2, 8]\n"))
    harness = load_harness(file)
    assert shown_steps(harness) == (2, 6, 8)
    material = material_of(harness, file)
    longer = swept(followed(harness, file, material, tmp_path), 0.25)
    assert longer.laid.line.length == pytest.approx(0.25)
    assert (longer.length, longer.bands) == (0.25, None)
    assert longer.way.radius <= longer.bend.radius
    assert longer.bend.step == 8


def test_what_is_nothing_but_rounding_is_no_doubt(tmp_path: Path) -> None:
    """A curl without weight, held at one end: its moment is what the solver leaves."""
    text = pushed(STIFFNESS).partition("  - kind: grip")[0]
    text = text.replace(f"{STIFFNESS}}}", f"{STIFFNESS}, spool: {{curvature: 1 1/m}}}}")
    found = run(tmp_path, f"{text}steps: 2\ngravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")
    (moment,) = (each for each in found.results if each.name == "moment.bench")
    assert moment.value == pytest.approx(0.0, abs=1e-9)
    assert moment.value != 0.0
    assert {each.status for each in found.results} == {Status.OK}


@pytest.mark.slow
def test_a_length_of_a_sweep_has_all_doubts_of_its_numbers(tmp_path: Path) -> None:
    """Six elements are too few for a line that is brought far round."""
    text = arch().replace("elements: 16", "elements: 6").replace("180 mm, 0 mm", "90 mm, 30 mm")
    file = written(tmp_path, text)
    harness = load_harness(file)
    material = material_of(harness, file)
    radius = run(tmp_path, text).results[0]
    one = swept(followed(harness, file, material, tmp_path), harness.line.length)
    assert radius.status is Status.DOUBTFUL
    assert one.status == "doubtful"
    assert {each.code for each in radius.reasons} <= {each.code for each in one.reasons}


@pytest.mark.slow
def test_loads_are_told_in_every_step(tmp_path: Path) -> None:
    """All that acts on a line, its weight included, is in balance."""
    push = "  - {kind: load, name: push, at: 55 mm, force: [0 N, 10 mN, -20 mN], by: 4}\nsteps:"
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    found = run(tmp_path, arch(section).replace("steps:", push))
    weight = 0.007 * 0.2 * 9.80665
    for step, state in enumerate(found.path.states):
        share = min(1.0, step / 4)
        assert state.reaction_forces[2] == pytest.approx(share * np.array([0.0, 0.01, -0.02]))
    assert found.path.last.reaction_forces.sum(axis=0) == pytest.approx((0, 0, weight), abs=1e-9)
    assert found.bands is not None
    band = found.bands.line.states[-1].reaction_forces
    assert band.lower[2] == pytest.approx([0.0, 0.01, -0.02])
    assert band.upper[2] == pytest.approx([0.0, 0.01, -0.02])


@pytest.mark.slow
def test_a_length_that_failed_has_no_numbers(tmp_path: Path) -> None:
    file = written(tmp_path, arch())
    harness = load_harness(file)
    one = swept(followed(harness, file, material_of(harness, file), tmp_path), 0.25)
    failed = replace(one, path=replace(one.path, status="failed"))
    assert math.isnan(failed.bend.radius)
    assert math.isnan(failed.way.radius)


def test_a_line_that_cannot_be_laid_is_bad_input(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 5 1/m, towards: [2, 0, 0]}\n"
    message = "line: expected a line that can be laid as its boundaries say, found this: towards="
    with pytest.raises(ProcessingError, match=re.escape(message)):
        run(tmp_path, arch(line=curl))


def test_a_line_limp_beyond_numbers_fails_without_a_warning(tmp_path: Path) -> None:
    """Warnings are errors here."""
    assert run(tmp_path, LIMP).status is Status.FAILED


LIMP = """\
version: 1
about: limp
line:
  length: 300 mm
  elements: 40
  section: {bending_stiffness: 1e-300 N*mm^2, torsional_stiffness: 8000 N*mm^2,
      largest_curvature: 200 1/m, diameter: 5.8 mm, mass_per_length: 55 g/m}
boundaries:
- kind: clip
  name: left
  at: start
  position: [0 mm, 0 mm, 0 mm]
  direction: [1, 0, 0]
steps: 20
"""
