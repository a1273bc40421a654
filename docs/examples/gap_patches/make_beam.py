"""Mesh a cantilever of 200 x 20 x 2 um with gmsh, and divide its bottom face into five patches.

    python make_beam.py

The file beam.msh contains the groups beam, clamp, tip and under1 to under5. Its unit is 1 um.
"""

from __future__ import annotations

import gmsh

LENGTH, WIDTH, THICKNESS, PATCHES = 200.0, 20.0, 2.0, 5


def mesh_beam(path: str) -> None:
    """Write the mesh of hexahedra to ``path``."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        model, occ = gmsh.model, gmsh.model.occ
        step = LENGTH / PATCHES
        for k in range(PATCHES):
            occ.addBox(k * step, 0, 0, step, WIDTH, THICKNESS)
        occ.fragment(occ.getEntities(3)[:1], occ.getEntities(3)[1:])
        occ.synchronize()
        solids = [tag for _, tag in model.getEntities(3)]
        model.addPhysicalGroup(3, solids, name="beam")
        for _, tag in model.getEntities(2):
            x, _, z = occ.getCenterOfMass(2, tag)
            if abs(x) < 1e-6:
                model.addPhysicalGroup(2, [tag], name="clamp")
            elif abs(x - LENGTH) < 1e-6:
                model.addPhysicalGroup(2, [tag], name="tip")
            elif abs(z) < 1e-6:
                model.addPhysicalGroup(2, [tag], name=f"under{int(x // step) + 1}")
            model.mesh.setTransfiniteSurface(tag)
            model.mesh.setRecombine(2, tag)
        for _, tag in model.getEntities(1):
            length = occ.getMass(1, tag)
            nodes = {step: 7, WIDTH: 3, THICKNESS: 2}
            model.mesh.setTransfiniteCurve(tag, nodes[min(nodes, key=lambda s: abs(s - length))])
        for tag in solids:
            model.mesh.setTransfiniteVolume(tag)
        model.mesh.generate(3)
        gmsh.write(path)
    finally:
        gmsh.finalize()


if __name__ == "__main__":
    mesh_beam("beam.msh")
