"""Bodies with meshes drawn at random, and their error estimates beside their errors.

The errors are differences to meshes that are two and four times as fine, extrapolated from there.
``PYTHONPATH=tests python tests/physics/drawn_meshes.py [FIRST LAST]`` prints them with the
effectivity, estimate over error, of draws 0 to 19 by default.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from support import (
    MESH_ERROR_PREFIX,
    StackKeys,
    bimorph,
    build_fe_model,
    disc,
    langevin,
    make_stack,
)
from test_body import write

SEED = 20261127
SMALL = 1e-3  # errors of a thousandth and less are no reason to refine: both must be
PZT, METALS, CERAMICS = "PZT-5A", ("steel", "brass", "aluminium"), ("PZT-5A", "PZT-8", "PZT-5H")
FACTS = {"resonance": "resonance_short_hz", "capacitance": "capacitance_free_f",
         "compliance": "resonance_hz"}  # fmt: skip


def round_plate(rng):
    """A buzzer of two layers, on cells up to three times as large as the part's."""
    wide = rng.uniform(10e-3, 40e-3)
    layers = [
        {"material": rng.choice(METALS), "diameter": wide, "thickness": rng.uniform(0.1, 1) * 1e-3},
        {"material": rng.choice(CERAMICS), "diameter": wide * rng.uniform(0.4, 0.95),
         "thickness": rng.uniform(0.1, 1) * 1e-3},
    ]  # fmt: skip
    supports = ("free", "clamped", "simply_supported", {"node": wide * rng.uniform(0.5, 0.8)})
    support, coarser = supports[rng.integers(4)], rng.uniform(1, 3)

    def make(refine, _):
        own = disc.make_disc_blocks(
            {"layers": layers, "support": support, "mesh": {"refine": refine}}
        )
        return replace(own, size=coarser * own.size).build_fe_model()

    return make


def bender(rng):
    """A beam of two or three layers, with elements twice as long as the part's."""
    metal = {"material": rng.choice(METALS), "thickness": rng.uniform(0.1, 0.6) * 1e-3}
    active = {"material": rng.choice(CERAMICS), "thickness": rng.uniform(0.1, 0.6) * 1e-3}
    table = {
        "layers": [metal, active] if rng.integers(2) else [active, metal, active],
        "length": rng.uniform(5, 40) * 1e-3, "width": rng.uniform(3, 10) * 1e-3,
        "tip_mass": rng.choice([0.0, 1e-3]),
        "support": rng.choice(["cantilever", "cantilever", "clamped", "free"]),
    }  # fmt: skip

    def make(refine, _):
        own = bimorph.make_bimorph_blocks({**table, "mesh": {"refine": refine}})
        return replace(own, grid=(own.grid[0][::2], *own.grid[1:])).build_fe_model()

    return make


def sandwich(rng):
    """A bolted transducer of two masses, or with a step in the front one."""
    wide = rng.uniform(15e-3, 50e-3)

    def mass(share):
        return {"material": rng.choice(["steel", "aluminium", "titanium"]),
                "diameter": share * wide, "length": rng.uniform(10e-3, 50e-3)}  # fmt: skip

    table = {
        "front": [mass(1.0), mass(rng.uniform(0.4, 0.9))] if rng.integers(2) else [mass(1.0)],
        "back": [mass(1.0)],
        "rings": {"material": "PZT-8", "outer": wide, "inner": 0.4 * wide,
                  "thickness": rng.uniform(2e-3, 6e-3), "count": int(rng.choice([2, 4]))},
        "bolt": {"material": "steel", "diameter": 0.3 * wide},
        "support": rng.choice(["free", "back"]),
    }  # fmt: skip
    coarser = rng.uniform(0.8, 2.5)

    def make(refine, _):
        own = langevin.make_langevin_blocks({**table, "mesh": {"refine": refine}})
        return replace(own, size=coarser * own.size).build_fe_model()

    return make


def stack(rng):
    """A chip of linear or quadratic hexahedra."""
    order = int(rng.integers(1, 3))
    side, mesh = rng.uniform(2e-3, 6e-3), {"sectors": 2 if order == 2 else 4, "order": order}
    mesh |= {"outer_rings": 4, "rings": 1, "ring_spacing": side / 10}
    table = {"side": side, "height": side * rng.uniform(0.5, 1.5), "layers": 4,
             "mounting": str(rng.choice(["roller", "glued", "free"]))}  # fmt: skip
    return lambda refine, _: make_stack(StackKeys(mesh={**mesh, "refine": refine}, **table))


def from_file(draw, size, dimension, **table):
    """A mesh of straight edges by gmsh, split for a finer one."""

    def make(refine, home):
        write(home / "own.msh", draw, size=size, order=1, mesh=dimension)
        return build_fe_model({"mesh": "own.msh", "unit": "mm", "refine": refine, **table}, home)

    return make


def box_groups(gmsh, boxes, margin):
    """Groups of boxes (two opposite corners by name) and of four of their faces, for the writer of
    meshes: entities within ``margin`` of each."""
    groups = {}
    for name, (low, high) in boxes.items():
        for dimension, word, (a, b) in (
            (3, "", (low, high)),
            (2, "_low", (low, (*high[:2], low[2]))),
            (2, "_high", ((*low[:2], high[2]), high)),
            (2, "_left", (low, (low[0], *high[1:]))),
            (2, "_right", ((high[0], *low[1:]), high)),
        ):
            near = (*np.subtract(a, margin), *np.add(b, margin))
            inside = gmsh.model.getEntitiesInBoundingBox(*near, dimension)
            if inside:
                groups[dimension, name + word] = [tag for _, tag in inside]
    return groups


def shape(pieces, holes, coarser):
    """Bonded pieces ``{name: (kind, low, high)}`` in millimetres, their lowest, highest, left and
    right faces as groups. A cylinder stands in its box; ``holes`` are cylinders cut out of the
    first piece; elements are so many times larger than gmsh has them by itself."""

    def solid(occ, kind, low, high):
        size = np.subtract(high, low)
        if kind == "cylinder":
            x, y = low[0] + size[0] / 2, low[1] + size[0] / 2
            return 3, occ.addCylinder(x, y, low[2], 0, 0, size[2], size[0] / 2)
        if kind == "wedge":
            return 3, occ.addWedge(*low, *size, ltx=size[0] / 3)
        return 3, occ.addBox(*low, *size)

    def draw(gmsh):
        gmsh.option.setNumber("Mesh.MeshSizeFactor", coarser)
        occ = gmsh.model.occ
        made = [solid(occ, *piece) for piece in pieces.values()]
        if holes:
            occ.cut(made[:1], [solid(occ, "cylinder", *hole) for hole in holes])
        if len(made) > 1:
            occ.fragment(made[:1], made[1:])
        occ.synchronize()
        return box_groups(gmsh, {name: ends for name, (_, *ends) in pieces.items()}, 1e-3)

    return draw


def tetrahedra(rng):
    """An odd shape with a ceramic, on few straight tetrahedra."""
    a, b = rng.uniform(10, 25), rng.uniform(4, 8)
    t, c = rng.uniform(0.8, 3), rng.uniform(0.4, 2)
    kind = rng.integers(5)
    fixed, port = ["body_left"], "body_right"
    holes = ()
    if kind == 0:  # plate with a hole
        body, pzt = ("box", (0, 0, 0), (a, b, t)), ("box", (0, 0, t), (a / 2, b, t + c))
        holes = [((0.7 * a, b / 4, 0), (0.7 * a + b / 2, 3 * b / 4, t))]
    elif kind == 1:  # bridge on two feet
        body = ("box", (0, 0, 0), (a, b, t))
        pzt = ("box", (a / 4, 0, t), (3 * a / 4, b, t + c))
        holes, fixed, port = (), ["body_left", "body_right"], "pzt_right"
    elif kind == 2:  # round ceramic on a block
        body = ("box", (0, 0, 0), (b + 2, b + 2, 2 * t))
        pzt = ("cylinder", (1, 1, 2 * t), (1 + b, 1 + b, 2 * t + 2 * c))
        fixed, port = ["body_low"], "pzt_high"
    elif kind == 3:  # ceramic under a wedge
        body, pzt = ("wedge", (0, 0, 0), (a, b, b)), ("box", (0, 0, -c), (a / 2, b, 0))
        port = "pzt_right"
    else:  # two cylinders, free
        body = ("cylinder", (0, 0, 0), (b, b, a / 2))
        pzt = ("cylinder", (b / 4, b / 4, a / 2), (3 * b / 4, 3 * b / 4, a / 2 + 2 * c))
        fixed, port = [], "pzt_high"
    table = {
        "materials": {"body": str(rng.choice(METALS)), "pzt": str(rng.choice(CERAMICS))},
        "fixed": fixed, "electrodes": {"anode": "pzt_high", "cathode": "pzt_low"},
        "ports": [{"name": "tip", "group": port, "axis": "z"}],
    }  # fmt: skip
    draw = shape({"body": body, "pzt": pzt}, holes, rng.uniform(1.5, 3))
    return from_file(draw, 1e3, 3, **table)


def meridian(rng):
    """A body of revolution with steps and a bore, on few triangles."""
    r, h = rng.uniform(5, 15), rng.uniform(2, 10)
    t, c = rng.uniform(0.5, 2), rng.uniform(0.3, 1.5)
    bore, ceramic = rng.choice([0.0, 0.2 * r]), rng.uniform(0.4, 0.9) * r
    rectangles = {
        "plate": ((bore, 0), (r, t)), "wall": ((0.8 * r, t), (r, t + h)),
        "pzt": ((bore, -c), (ceramic, 0)),
    }  # fmt: skip

    def draw(gmsh):
        occ = gmsh.model.occ
        made = [
            (2, occ.addRectangle(*low, 0, *np.subtract(high, low)))
            for low, high in rectangles.values()
        ]
        occ.fragment(made[:1], made[1:])
        occ.synchronize()

        def inside(dimension, low, high):
            box = (low[0] - 1e-6, low[1] - 1e-6, -1, high[0] + 1e-6, high[1] + 1e-6, 1)
            return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, dimension)]

        groups = {(2, name): inside(2, *box) for name, box in rectangles.items()}
        return groups | {
            (1, "rim"): inside(1, (0.8 * r, t + h), (r, t + h)),
            (1, "up"): inside(1, (bore, 0), (ceramic, 0)),
            (1, "low"): inside(1, (bore, -c), (ceramic, -c)),
            (1, "floor"): inside(1, (bore, t), (0.8 * r, t)),
        }

    metal = str(rng.choice(METALS))
    return from_file(
        draw, rng.uniform(0.1, 0.4) * r, 2, axisymmetric=True,
        materials={"plate": metal, "wall": metal, "pzt": str(rng.choice(CERAMICS))},
        fixed=["rim"] if rng.integers(2) else [],
        electrodes={"anode": "low", "cathode": "up"},
        ports=[{"name": "floor", "group": "floor", "axis": "z"}],
    )  # fmt: skip


KINDS = (round_plate, tetrahedra, sandwich, bender, meridian, tetrahedra, stack)
FINEST = {bender: 2}  # refinement of the finest mesh, elsewhere 4


def drawn(number):
    """Kind of a draw, its body as a function of refinement and folder, and the finest mesh."""
    kind = KINDS[number % len(KINDS)]
    return kind.__name__, kind(np.random.default_rng([SEED, number])), FINEST.get(kind, 4)


def rows(make, home, finest):
    """What, unknowns, error, its uncertainty and the estimate, relative, of each fact that the mesh
    ``make(1, home)`` has an estimate of."""
    found, half, fine = (make(refine, home).model.facts for refine in (1, finest // 2, finest))
    strokes = [name for name in fine if name.startswith("free_stroke_")]
    facts = FACTS | dict(zip(["stroke"], strokes, strict=False))
    for word, name in facts.items():
        estimate = found.get(f"{MESH_ERROR_PREFIX}{word}")
        if estimate is None or name not in fine:
            continue
        last, first = fine[name] - half[name], half[name] - found[name]
        # what a finer mesh leaves is a geometric series, from corners to smooth; else half is left
        ratio = first / last if finest > 2 and last else 0.0
        left = last / (ratio - 1) if 1.5 < ratio < 16 else 0.5 * last
        exact = fine[name] + left
        error, unsure = abs(found[name] / exact - 1), abs(left / exact)
        yield word, int(found["unknowns"]), error, unsure, estimate


if __name__ == "__main__":
    first, last = (int(word) for word in (sys.argv[1:] or ("0", "19")))
    for number in range(first, last + 1):
        kind, make, finest = drawn(number)
        with tempfile.TemporaryDirectory() as home:
            for word, unknowns, error, unsure, estimate in rows(make, Path(home), finest):
                ratio = f"{estimate / error:.2f}" if max(error, estimate) >= SMALL else "-"
                print(
                    f"{number:3} {kind:11} {unknowns:7} unknowns  {word:11} error {error:7.2%} "
                    f"(+- {unsure:5.2%})  estimate {estimate:7.2%}  effectivity {ratio}",
                    flush=True,
                )
