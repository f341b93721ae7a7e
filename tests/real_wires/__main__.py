"""Fit two wires that others hung and twisted.

``python -m tests.real_wires FOLDER`` prints the tables, FOLDER being that of the real exports;
``--publish`` puts them and the pictures into docs/explanations/real-rods.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.builders.arm_poses import POSES
from tests.builders.real_wires import BLACK, WHITE
from tests.real_wires.page import counted, publish
from tests.real_wires.poses import study_pose, told
from tests.real_wires.studied import study


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.real_wires", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the real exports")
    parser.add_argument("--publish", action="store_true", help="put the tables into the docs")
    options = parser.parse_args()
    studies = [study(wire, options.folder) for wire in (WHITE, BLACK)]
    poses = [
        study_pose(each.wire, number, options.folder, *each.stiffnesses)
        for each in studies
        for number in range(len(POSES))
    ]
    print(counted(studies), told(poses), sep="\n\n")
    if options.publish:
        publish(studies, poses, options.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
