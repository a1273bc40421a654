"""Write beam.msh: a cantilever of 200 x 20 x 2 um, whose lower face consists of ten patches."""

import gmsh

LENGTH, WIDTH, THICKNESS, PATCHES = 200.0, 20.0, 2.0, 10  # micrometres
STRIP = LENGTH / PATCHES

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
shapes = gmsh.model.occ
boxes = [(3, shapes.addBox(k * STRIP, 0, 0, STRIP, WIDTH, THICKNESS)) for k in range(PATCHES)]
shapes.fragment(boxes[:1], boxes[1:])
shapes.synchronize()

solids = [tag for _, tag in gmsh.model.getEntities(3)]
gmsh.model.addPhysicalGroup(3, solids, name="silicon")
for _, face in gmsh.model.getEntities(2):
    x, _, z = gmsh.model.occ.getCenterOfMass(2, face)
    if abs(x) < 1e-6:
        gmsh.model.addPhysicalGroup(2, [face], name="clamp")
    elif abs(x - LENGTH) < 1e-6:
        gmsh.model.addPhysicalGroup(2, [face], name="end")
    elif abs(z) < 1e-6:
        gmsh.model.addPhysicalGroup(2, [face], name=f"strip{1 + int(x // STRIP)}")

for _, curve in gmsh.model.getEntities(1):
    low_x, low_y, _, high_x, high_y, _ = gmsh.model.getBoundingBox(1, curve)
    elements = 5 if high_x - low_x > 1 else 4 if high_y - low_y > 1 else 2
    gmsh.model.mesh.setTransfiniteCurve(curve, elements + 1)
for _, face in gmsh.model.getEntities(2):
    gmsh.model.mesh.setTransfiniteSurface(face)
    gmsh.model.mesh.setRecombine(2, face)
for solid in solids:
    gmsh.model.mesh.setTransfiniteVolume(solid)
gmsh.model.mesh.generate(3)
gmsh.write("beam.msh")
