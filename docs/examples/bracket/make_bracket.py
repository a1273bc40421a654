"""Draw an angle bracket with two piezo patches and write it as STEP, as a CAD tool would.

    python make_bracket.py [FILE]

The frame is 60 x 20 x 2 mm with a foot of 2 x 20 x 20 mm; patches of 30 x 14 x 0.5 mm sit above
and below the arm. The file holds three solids and no names: bracket.toml picks by points.
"""

from __future__ import annotations

import sys

import gmsh


def draw(path: str) -> None:
    """Write the bracket to ``path``, in millimetres."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        occ = gmsh.model.occ
        arm, foot = occ.addBox(0, 0, 0, 60, 20, 2), occ.addBox(0, 0, 2, 2, 20, 18)
        occ.fuse([(3, arm)], [(3, foot)])
        occ.addBox(5, 3, 2, 30, 14, 0.5)
        occ.addBox(5, 3, -0.5, 30, 14, 0.5)
        occ.synchronize()
        gmsh.write(path)
    finally:
        gmsh.finalize()


if __name__ == "__main__":
    draw(sys.argv[1] if len(sys.argv) > 1 else "bracket.step")
