"""The quarter chip assembled by hand: trilinear elements in numpy, nothing of the product's but the
positions of its nodes."""

import numpy as np

# Gauss points of the unit interval, for two points the degree 3 that each direction needs.
GAUSS = np.array([0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)])
# The data sheet of the paper's ceramic, stiffness [Pa], coupling [C/m^2], permittivity at strain.
C = np.zeros((6, 6))
C[:3, :3] = [[158.9e9, 113.0e9, 117.1e9], [113.0e9, 158.9e9, 117.1e9], [117.1e9, 117.1e9, 144.2e9]]
C[3:, 3:] = np.diag([14.08e9, 14.08e9, 22.94e9])
PIEZO = np.array([[0, 0, 0, 0, 13.38, 0], [0, 0, 0, 13.38, 0, 0], [-3.914, -3.914, 27.50, 0, 0, 0]])
EPS_T = 8.8541878188e-12 * np.diag([3370.0, 3370.0, 3300.0])
EPS_S = EPS_T - PIEZO @ np.linalg.inv(C) @ PIEZO.T
DENSITY = 7700.0


def triangle():
    """Points, weights, shape functions (points, 3) and their slopes (points, 3, 2)."""
    points = np.array([[0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
    shapes = np.column_stack([1 - points.sum(axis=1), points])
    slopes = np.tile([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]], (3, 1, 1))
    return np.full(3, 1 / 6), shapes, slopes


def square():
    """The same of four corners, in order around the square."""
    r, s = (x.ravel() for x in np.meshgrid(GAUSS, GAUSS))
    shapes = np.column_stack([(1 - r) * (1 - s), r * (1 - s), r * s, (1 - r) * s])
    slopes = np.stack([
        np.column_stack([-(1 - s), 1 - s, s, -s]), np.column_stack([-(1 - r), -r, r, 1 - r]),
    ], axis=2)  # fmt: skip
    return np.full(4, 0.25), shapes, slopes


def element(corners, height, rule):
    """Stiffness, coupling and permittivity of a prism over ``corners`` (n, 2), and its mass."""
    weights, shapes, slopes = rule()
    n = len(corners)
    mass, stiff = np.zeros((2 * n, 2 * n)), np.zeros((6 * n, 6 * n))
    couple, diel = np.zeros((6 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    for weight, shape, slope in zip(weights, shapes, slopes, strict=True):
        jacobian = slope.T @ corners
        plane = slope @ np.linalg.inv(jacobian).T
        for z in GAUSS:
            N = np.concatenate([shape * (1 - z), shape * z])
            along = np.concatenate([-shape, shape]) / height
            dN = np.column_stack([np.vstack([plane * (1 - z), plane * z]), along])
            volume = weight * abs(np.linalg.det(jacobian)) * height / 2
            B = np.zeros((6, 6 * n))
            for axis in range(3):
                B[axis, axis::3] = dN[:, axis]
            for row, (a, b) in enumerate([(1, 2), (0, 2), (0, 1)], 3):
                B[row, a::3], B[row, b::3] = dN[:, b], dN[:, a]
            mass += volume * DENSITY * np.outer(N, N)
            stiff += volume * B.T @ C @ B
            couple += volume * B.T @ PIEZO.T @ dN.T
            diel += volume * dN @ EPS_S @ dN.T
    return mass, stiff, couple, diel


def chip(plane, spokes, heights):
    """``M, K, k, c, shapes`` of the supported quarter chip, a layer an element: ``K u = -k V`` and
    ``Q = c V - k u``; the shapes are those of the rings.

    ``plane`` (nodes, 2): the centre, then circle by circle of ``spokes`` nodes from x to y.
    """
    circles = (len(plane) - 1) // spokes
    cells = [((0, 1 + j, 2 + j), triangle) for j in range(spokes - 1)]
    for i in range(circles - 1):
        first = 1 + i * spokes
        for j in range(first, first + spokes - 1):
            cells.append(((j, j + spokes, j + spokes + 1, j + 1), square))
    each, planes = len(plane), len(heights)
    size = each * planes
    M, K = np.zeros((3 * size, 3 * size)), np.zeros((3 * size, 3 * size))
    coupling, dielectric = np.zeros((3 * size, size)), np.zeros((size, size))
    for corners, rule in cells:
        own = element(plane[list(corners)], heights[1] - heights[0], rule)
        for level in range(planes - 1):
            nodes = np.r_[each * level + np.array(corners), each * (level + 1) + np.array(corners)]
            dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
            sign = 1.0 if level % 2 else -1.0  # poled towards the cathode below
            for axis in range(3):
                M[np.ix_(dofs[axis::3], dofs[axis::3])] += own[0]
            K[np.ix_(dofs, dofs)] += own[1]
            coupling[np.ix_(dofs, nodes)] += sign * own[2]
            dielectric[np.ix_(nodes, nodes)] += own[3]
    x, y = np.tile(plane.T, planes)
    z = np.repeat(heights, each)
    fixed = np.column_stack([x < 1e-9, y < 1e-9, z < 1e-9]).ravel()
    free = np.flatnonzero(~fixed)
    anode = np.repeat(np.arange(planes) % 2, each).astype(float)
    return (
        M[np.ix_(free, free)], K[np.ix_(free, free)], (coupling @ anode)[free],
        anode @ dielectric @ anode, free, 3 * each * (planes - 1),
    )  # fmt: skip


def ring_shapes(free, top, stations, spokes):
    """Columns of unit ring forces on the top: the centre, then circles ``stations``; their ends lie
    on the planes of symmetry and carry half."""
    shapes = np.zeros((free.max() + 1, len(stations)))
    for column, circle in enumerate(stations):
        weights = np.r_[0.5, np.ones(spokes - 2), 0.5] if circle else np.ones(1)
        first = 1 + (circle - 1) * spokes if circle else 0
        nodes = first + np.arange(len(weights))
        shapes[top + 3 * nodes + 2, column] = weights / weights.sum()
    return shapes[free]
