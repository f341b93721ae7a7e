"""The poses of both wires in space: computed, told and drawn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure

from labpipe.records.arrays import Floats
from tests.builders.arm_poses import POSES, distances, posed, seen
from tests.builders.real_wires import RealWire
from tests.real_wires.pictures import COLOURS, STYLE


@dataclass(frozen=True, slots=True, eq=False)
class PoseStudy:
    """A pose of a wire.

    Parameters
    ----------
    wire, number : of which
    points : seen, shape (points, 3), m
    nodes : computed, shape (nodes, 3), m
    off : distances of the points from the line, m
    untwisted : the same of a line that was not twisted
    snapped : whether it snapped over while it was twisted
    """

    wire: RealWire
    number: int
    points: Floats
    nodes: Floats
    off: Floats
    untwisted: Floats
    snapped: bool


def study_pose(
    wire: RealWire, number: int, folder: Path, stiffness: float, torsion: float
) -> PoseStudy:
    """Compute a pose with stiffnesses from the hangs and the twist."""
    points, pose = seen(wire, folder)[number], POSES[number]
    path = posed(wire, pose, points[-1], stiffness, torsion)
    plain = posed(wire, pose, points[-1], stiffness, torsion, twist=0.0)
    off, untwisted = distances(points, path), distances(points, plain)
    # the first step lays the straight line into its arc, by a jump
    snapped = max(path.snapped, default=0) > 1
    return PoseStudy(wire, number, points, path.last.positions, off, untwisted, snapped)


def told(studies: list[PoseStudy]) -> str:
    """A table: distances left in each pose."""
    lines = [
        "| wire | pose | twist, degrees | distance left, mean (largest), mm | not twisted, mm |",
        "|---|---|---|---|---|",
    ]
    for each in studies:
        left = [f"{1e3 * off.mean():.1f} ({1e3 * off.max():.0f})" for off in _both(each)]
        note = ", snapped over" if each.snapped else ""
        twist = f"{POSES[each.number].twist:.0f}"
        name = f"{each.wire.name} | {each.number}{note}"
        lines.append(f"| {name} | {twist} | {left[0]} | {left[1]} |")
    return "\n".join(lines)


def _both(each: PoseStudy) -> tuple[Floats, Floats]:
    return each.off, each.untwisted


def draw_poses(studies: list[PoseStudy], path: Path) -> None:
    """From the front above, from the top below: points that were seen, lines of the model."""
    wires = list(dict.fromkeys(each.wire.name for each in studies))
    with style.context(STYLE):
        page = Figure(figsize=(6.3, 4.6), layout="constrained")
        panels = page.subplots(2, len(wires), sharex=True)
        for each in studies:
            column, colour = wires.index(each.wire.name), COLOURS[each.number]
            for row, axis in ((0, 2), (1, 1)):
                axes = panels[row, column]
                axes.plot(each.points[:, 0], each.points[:, axis], ".", color=colour, markersize=4)
                label = f"Pose {each.number}" if row == 0 else None
                axes.plot(each.nodes[:, 0], each.nodes[:, axis], color=colour, label=label)
        for column, name in enumerate(wires):
            panels[0, column].set_title(f"{name.capitalize()} wire")
            panels[1, column].set_xlabel("To the right (m)")
        panels[0, 0].set_ylabel("Up (m)")
        panels[1, 0].set_ylabel("Away from the camera (m)")
        for axes in np.ravel(panels):
            axes.set_aspect("equal")
        handles = panels[0, 0].get_legend_handles_labels()
        page.legend(*handles, loc="outside lower center", ncols=len(POSES))
        page.savefig(path, dpi=110, metadata={"Software": None})
