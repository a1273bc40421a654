"""Fields back: closed-form stresses, motion against exact integrals, files read by others."""

import meshio
import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.signal import StateSpace, lsim
from skfem.mesh import MeshHex, MeshQuad, MeshTet, MeshTet2, MeshTri, MeshTri2
from support import (
    OBLIQUE_SHIFT,
    Block,
    BondedBlocks,
    BoundaryConditions,
    DampingKeys,
    FieldProbe,
    Port,
    PortLoad,
    Solid,
    StackKeys,
    UsageError,
    compute_largest_principal_stress,
    compute_lowest_modes,
    compute_node_shares,
    disc,
    draw_deformed_body,
    draw_modes,
    evaluate_at_nodes,
    find_extremes,
    find_material,
    langevin,
    load_scene,
    make_damped_model,
    make_stack,
    recover_motion,
    recover_vibration,
    spread_force,
    write_vtu,
)

PZT = find_material("PZT-5A")
SIZE = np.array([4e-3, 1e-3, 0.5e-3])


def plate(kind=MeshTet, made_of=PZT):
    mesh = kind.init_tensor(*(np.linspace(0, s, n) for s, n in zip(SIZE, (5, 2, 3), strict=True)))
    mesh = MeshTet2.from_mesh(mesh) if kind is MeshTet else mesh
    return Solid(mesh, (made_of,), np.zeros(mesh.nelements, int))


def at(solid, axis, value):
    return np.flatnonzero(np.abs(solid.basis(1).doflocs[axis] - value) < 1e-9)


def pulled(solid, damping=None):
    """A bar held at x = 0 without hindering its contraction, pulled at the other end, with
    electrodes below and above."""
    x = solid.basis(1).doflocs
    fixed = np.zeros((x.shape[1], 3), bool)
    fixed[x[0] < 1e-9, 0] = True
    fixed[np.all(x < 1e-9, axis=0)] = True
    fixed[(x[0] < 1e-9) & (x[1] < 1e-9), 1] = True
    end = solid.mesh.facets_satisfying(lambda p: p[0] > SIZE[0] - 1e-9)
    pull = PortLoad(
        Port("pull", "mechanical"),
        spread_force(compute_node_shares(solid, facets=end), np.eye(3)[0], solid),
    )
    electrodes = {"anode": at(solid, 2, SIZE[2]), "cathode": at(solid, 2, 0.0)}
    return make_damped_model(solid, BoundaryConditions(
        fixed.ravel(), electrodes, "cathode", shapes=[pull],
        damping=damping or DampingKeys(ratio=0.02),
    ))  # fmt: skip


def at_points(probe, z, voltages):
    T, E = probe.compute_stress_and_field(
        *probe.compute_nodal_values(z[:, None], voltages[:, None])
    )
    return T[..., 0], E[..., 0]


def outputs(motion):
    model = motion.device.model
    return motion.states @ (model.C @ motion.basis).T + motion.inputs @ model.D.T


@pytest.mark.parametrize("kind", [MeshTet, MeshHex])
def test_uniform_stress_and_field_are_exact(kind):
    device = pulled(plate(kind))
    time = np.array([0.0, 1e-6, 2e-6])  # at rest under constant inputs: static
    force, voltage = 3.0, 20.0
    motion = recover_motion(device, time, {"pull": np.full(3, force), "anode": np.full(3, voltage)})
    for gauss in (False, True):
        stress, field = at_points(
            FieldProbe(device, gauss=gauss), *motion.find_nearest_sample(1e-6)
        )
        pressure = force / (SIZE[1] * SIZE[2])
        assert stress[:, 0] == pytest.approx(pressure, rel=1e-6)
        assert np.abs(stress[:, 1:]).max() < 1e-6 * pressure
        assert field[:, 2] == pytest.approx(-voltage / SIZE[2], rel=1e-6)
    strain = np.linalg.inv(PZT.C)[0, 0] * pressure - PZT.d[2, 0] * voltage / SIZE[2]
    stretched = evaluate_at_nodes(device, *motion.find_nearest_sample(1e-6))["displacement"][
        :, 0
    ].max()
    assert stretched == pytest.approx(strain * SIZE[0], rel=1e-6)
    stress, field, opposing = find_extremes(motion)
    assert (stress.quantity, stress.unit, stress.limit) == ("principal_stress", "Pa", 76e6)
    assert stress.value == pytest.approx(pressure, rel=1e-6)
    assert (field.quantity, field.limit) == ("electric_field", None)
    assert (opposing.quantity, opposing.limit) == ("opposing_field", 0.7e6)  # E = -V/t z
    for each in (field, opposing):
        assert each.value == pytest.approx(voltage / SIZE[2], rel=1e-6)
    reverse = recover_motion(device, time, {"anode": np.full(3, -voltage)})
    assert find_extremes(reverse)[2].value == pytest.approx(-voltage / SIZE[2], rel=1e-6)


CERAMIC = {"material": "PZT-5A", "diameter": "6 mm", "thickness": "1 mm"}
SANDWICH = {
    "front": [{"material": "aluminium", "diameter": "20 mm", "length": "15 mm"}],
    "back": [{"material": "steel", "diameter": "20 mm", "length": "10 mm"}],
    "rings": {"material": "PZT-8", "outer": "20 mm", "inner": "8 mm", "thickness": "3 mm"},
    "bolt": {"material": "steel", "diameter": "6 mm"},
    "support": "back",
}


def chip(**keys):
    kick = StackKeys(layers=6, layer_thickness=60e-6, **keys)
    return make_stack(kick, 2e6)


def test_free_disc_and_free_stack_have_a_uniform_field_and_no_stress():
    """Poled against it or along it, strains are d' E and nothing else."""
    still = np.linspace(0, 1e-6, 3)
    for device, thick, height, sign in (
        (disc.make_disc_blocks({"layers": [CERAMIC]}).build_fe_model(), 1e-3, 1e-3, 1),
        (
            disc.make_disc_blocks({"layers": [CERAMIC | {"poling": "down"}]}).build_fe_model(),
            1e-3,
            1e-3,
            -1,
        ),
        (chip(), 60e-6, 360e-6, -1),  # a positive voltage lengthens it
    ):
        motion = recover_motion(device, still, {"anode": np.full(3, 30.0)})
        stress, field, opposing = find_extremes(motion)
        e33 = np.abs(device.solid.materials[0].e).max()
        assert stress.value < 1e-4 * e33 * 30 / thick
        assert field.value == pytest.approx(30 / thick, rel=1e-6)
        assert opposing.value == pytest.approx(sign * 30 / thick, rel=1e-6)
        top = evaluate_at_nodes(device, *motion.find_nearest_sample(0.0))["displacement"][:, 2]
        m = device.solid.materials[0]
        d33 = abs(np.linalg.solve(m.C, m.e[2])[2])
        assert np.ptp(top) == pytest.approx(d33 * 30 / thick * height, rel=1e-4)


@pytest.mark.parametrize(("device", "port", "symmetric"), [
    (lambda: langevin.make_langevin_blocks(SANDWICH).build_fe_model(), "front", 1),
    (lambda: chip(mounting="glued", bottom_cap={"thickness": 1e-4}), "ring2", 4),
    (lambda: chip(preload_spring=1, top_cap={"thickness": 1e-4, "material": "steel"}), "ring0", 4),
])  # fmt: skip
def test_every_section_of_a_pressed_body_carries_the_total_force(device, port, symmetric):
    """Statics: the axial stress over any cross-section is the force on the end."""
    device, force = device(), -50.0
    motion = recover_motion(device, np.linspace(0, 1e-6, 3), {port: np.full(3, force)})
    probe = FieldProbe(device, gauss=True)
    axial = at_points(probe, *motion.find_nearest_sample(0.0))[0][:, 2]
    basis = probe.basis
    where = np.asarray(basis.global_coordinates())
    weights = np.broadcast_to(basis.dx, where.shape[1:])
    if device.solid.axisymmetric:
        weights = 2 * np.pi * where[0] * weights
    heights = device.solid.mesh.p[-1][device.solid.mesh.t]
    layers = {tuple(pair) for pair in np.round(np.array([heights.min(0), heights.max(0)]).T, 9)}
    for low, high in layers:  # of elements
        own = (np.abs(heights.min(0) - low) < 1e-8) & (np.abs(heights.max(0) - high) < 1e-8)
        carried = (axial.reshape(weights.shape) * weights)[own].sum() / (high - low)
        assert carried == pytest.approx(force / symmetric, rel=2e-2)


def test_fields_of_merged_layers_are_refused():
    with pytest.raises(UsageError, match="each contain one layer"):
        load_scene("kick_and_catch", {"kick.fields": True, "kick.mesh.layers_per_element": 2})


def test_motion_is_that_of_the_full_model():
    """Against modes of the dense matrices and scipy's integration of the state space."""
    device = pulled(plate(), DampingKeys(ratio=0.05))
    model = device.model
    time = np.linspace(0, 2e-5, 801)
    inputs = np.column_stack([np.sin(4e5 * time) * (time < 1e-5), 30 * np.clip(time / 1e-6, 0, 1)])
    found = recover_motion(device, time, dict(zip(("pull", "anode"), inputs.T, strict=True)))
    squares, X = eigh(model.K.toarray(), model.M.toarray())
    keep = squares < (2 * np.pi * 60e6) ** 2
    squares, X = squares[keep], X[:, keep]
    n, (alpha, beta) = len(squares), model.rayleigh
    A = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.diag(squares), -np.diag(alpha + beta * squares)]]
    )
    gain = X.T @ model.B
    B, C = np.vstack([np.zeros_like(gain), gain]), np.hstack([gain.T, np.zeros_like(gain.T)])
    _, y, _ = lsim(StateSpace(A, B, C, model.D), inputs, time)
    assert (np.abs(outputs(found) - y).max(axis=0) < 2e-3 * np.abs(y).max(axis=0)).all()


def test_a_bar_in_longitudinal_resonance_has_the_stress_of_its_velocity():
    """u = U sin(k x) / sin(k L) in a bar that is fixed at x = 0: the stress at the fixed end is
    rho c omega U / sin(k L) for the amplitude U of the other end. U is that of the full model."""
    radius, length, steel = 1e-3, 20e-3, find_material("steel")
    ends = [((0.0, radius), (height, height)) for height in (0.0, length)]
    device = BondedBlocks(
        [Block(((0.0, radius), (0.0, length)), steel)],
        ports={"pull": ends[1]},
        fixed=[("z", ends[0])],
        size=radius / 2,
        damping=DampingKeys(quality=30),
    ).build_fe_model()
    speed = 1 / np.sqrt(np.linalg.inv(steel.C)[0, 0] * steel.density)
    quarter_wave = speed / (4 * length)
    f = quarter_wave * np.linspace(0.3, 1.7, 281)
    pull = np.full(f.size, 3.0 * np.exp(0.7j))
    motion = recover_vibration(device, f, {"pull": pull})
    stress, *_ = find_extremes(motion, np.arange(motion.scale.size))
    assert stress.at == pytest.approx(quarter_wave, rel=5e-3)
    (port,) = (k for k, each in enumerate(device.model.ports) if each.name == "pull")
    end = 3.0 * np.abs(device.model.transfer(np.array([stress.at]))[0, port, port])
    omega = 2 * np.pi * stress.at
    exact = steel.density * speed * omega * end / np.sin(omega / speed * length)
    assert stress.value == pytest.approx(exact, rel=5e-3)
    # far below the resonance: the static stress
    motion = recover_vibration(device, np.array([0.0, 10.0]), {"pull": pull[:2]})
    stress, *_ = find_extremes(motion, np.arange(motion.scale.size))
    assert stress.value == pytest.approx(3.0 / (np.pi * radius**2), rel=1e-3)


def test_the_field_of_a_vibration_is_that_of_its_largest_voltage():
    """Below all resonances, the amplitude of the field is the voltage over the thickness."""
    device, f = pulled(plate()), np.array([1e3, 2e3, 3e3, 4e3])
    volts = np.array([10, 30j, 20, 5])
    motion = recover_vibration(device, f, {"anode": volts})
    _, field, opposing = find_extremes(motion, np.arange(motion.scale.size))
    for each in (field, opposing):  # either sign of the field occurs in each period
        assert each.at == 2e3
        assert each.value == pytest.approx(30 / SIZE[2], rel=2e-3)


def test_a_free_body_falls_by_newtons_law():
    solid = plate(MeshHex, find_material("steel"))
    fixed = np.zeros(3 * solid.basis(1).N, bool)
    everywhere = spread_force(
        compute_node_shares(solid, elements=np.arange(solid.mesh.nelements)), np.eye(3)[2], solid
    )
    push = PortLoad(Port("push", "mechanical"), everywhere)
    device = make_damped_model(
        solid, BoundaryConditions(fixed, shapes=[push], damping=DampingKeys(ratio=0.01, at=1e6))
    )
    time = np.linspace(0, 1e-3, 50)
    force = np.where(time > 0, 1e-3, 0.0)
    found = outputs(recover_motion(device, time, {"push": force}))[-1, 0]
    start = time[1]  # the force rises linearly over the first step
    late = time[-1] - start
    velocity = 0.5 * start
    distance = 1e-3 * (start**2 / 6 + velocity * late + late**2 / 2)
    assert found == pytest.approx(distance / device.model.facts["mass_kg"], rel=1e-5)


def test_largest_principal_stress_is_the_largest_eigenvalue():
    voigt = np.random.default_rng(0).standard_normal((500, 6))
    voigt[:3] = [[0] * 6, [1, 1, 1, 0, 0, 0], [-2, -2, -2, 0, 0, 1e-9]]
    place = [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
    wanted = np.linalg.eigvalsh(voigt[:, place])[:, -1]
    assert compute_largest_principal_stress(voigt) == pytest.approx(wanted, abs=1e-7)
    tiny = 1e-200  # whose cube is no number any more
    assert compute_largest_principal_stress(tiny * voigt[3:]) == pytest.approx(
        tiny * wanted[3:], rel=1e-7, abs=0
    )


@pytest.mark.parametrize(("kind", "cell"), [
    (MeshTet, "tetra10"), (MeshHex, "hexahedron27"), (MeshTri, "triangle6"), (MeshQuad, "quad9"),
])  # fmt: skip
def test_another_reader_reads_the_same_file_content(tmp_path, kind, cell):
    if kind in (MeshTri, MeshQuad):
        flat = kind.init_tensor(np.linspace(0, 2e-3, 3), np.linspace(0, 0.5e-3, 2))
        mesh = MeshTri2.from_mesh(flat) if kind is MeshTri else flat
        solid = Solid(mesh, (PZT,), np.zeros(flat.nelements, int), True)
        heights = solid.basis(1).doflocs[1]
        fixed = np.zeros((heights.size, 2), bool)
        fixed[heights < 1e-9, 1] = True
        fixed[solid.basis(1).doflocs[0] < 1e-9, 0] = True
        electrodes = {"anode": np.flatnonzero(heights > 0.5e-3 - 1e-9),
                      "cathode": np.flatnonzero(heights < 1e-9)}  # fmt: skip
        device = make_damped_model(solid, BoundaryConditions(fixed.ravel(), electrodes, "cathode"))
    else:
        device = pulled(plate(kind))
    n = device.model.order
    voltage = np.array([7.0])
    electrical = device.model.B[:, -1:] @ voltage
    z = device.model.pencil.factorise_shifted_stiffness(0.0).solve(electrical)
    write_vtu(tmp_path / "a.vtu", device, z, voltage)
    found = meshio.read(tmp_path / "a.vtu")
    assert z.shape == (n,)
    assert [block.type for block in found.cells] == [cell]
    nodes = found.cells[0].data
    corners, ends = {
        "tetra10": (4, "01 12 02 03 13 23"),
        "triangle6": (3, "01 12 20"),
        "quad9": (4, "01 12 23 30"),
        "hexahedron27": (8, "01 12 23 30 45 56 67 74 04 15 26 37"),
    }[cell]
    for k, (a, b) in enumerate(map(int, pair) for pair in ends.split()):
        halfway = (found.points[nodes[:, a]] + found.points[nodes[:, b]]) / 2
        assert found.points[nodes[:, corners + k]] == pytest.approx(halfway, abs=1e-12)
    if cell == "hexahedron27":
        edges = found.points[nodes[:, (1, 3, 4)]] - found.points[nodes[:, :1]]
        assert (np.linalg.det(edges) > 0).all()  # right-handed, as VTK has them
    z_at = found.points[:, 2]
    assert found.point_data["potential"] == pytest.approx(7.0 * z_at / 0.5e-3, abs=1e-6)
    assert found.point_data["field"][:, 2] == pytest.approx(-14e3, rel=1e-6)
    # the free plate is stretched by d31 and d33 alone
    move = found.point_data["displacement"]
    top = z_at > 0.5e-3 - 1e-9
    assert move[top, 2] == pytest.approx(PZT.d[2, 2] * -7.0, rel=1e-5)
    assert np.abs(found.point_data["stress"]).max() < 1e-3 * 14e3 * abs(PZT.e[2, 0])


@pytest.mark.parametrize("kind", [MeshTet, MeshHex])
def test_a_picture_shows_the_surface_in_the_colour_of_its_stress(kind):
    """A bar under 1 N has one stress; its picture is front, top and right side."""
    device = pulled(plate(kind))
    model = device.model
    z = model.pencil.make_dense().coefficients[0]
    z = np.linalg.solve(z, model.B[:, [p.name for p in model.ports].index("pull")])
    panel, factor = draw_deformed_body(device, z, np.zeros(device.drive.shape[1]))
    L, b, h = SIZE * 1e3
    shown = panel.map.z[np.isfinite(panel.map.z)]
    assert shown == pytest.approx(1 / (b * h), rel=1e-3)  # MPa
    dot = np.diff(panel.map.x).mean() * np.diff(panel.map.y).mean()
    stretched = L + 1e3 * factor * np.abs(z).max()
    area = stretched * h + OBLIQUE_SHIFT * b * (stretched + h)
    assert shown.size * dot == pytest.approx(area, rel=0.05)
    assert 1.0 < stretched / L < 1.2


def test_shapes_of_modes_are_those_of_the_matrices():
    device = pulled(plate())
    K, _, M = device.model.pencil.make_dense().coefficients
    exact = np.sqrt(eigh(K, M, eigvals_only=True)) / (2 * np.pi)
    hertz, columns = compute_lowest_modes(device, 4, np.inf)
    assert len(hertz) == 4
    for f, z in zip(hertz, columns.T, strict=True):
        assert np.abs(exact / f - 1).min() < 1e-3
        assert np.linalg.norm(K @ z - (2 * np.pi * f) ** 2 * (M @ z)) < 0.05 * np.linalg.norm(K @ z)
    panels = list(draw_modes(device, hertz, columns))
    assert len(panels) == 4
    for f, panel in zip(hertz, panels, strict=True):
        assert f"{f / 1e3:.4g} kHz" in panel.x
        assert np.nanmax(panel.map.z) == pytest.approx(1.0, abs=0.02)
