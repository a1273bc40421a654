"""Constants of the built-in materials, computed from the tensors that the models use."""

import tomllib
from pathlib import Path

import numpy as np
from scipy.constants import epsilon_0
from tables import print_table

from kc2spice.fem import materials

NAMES = tomllib.loads(Path(materials.__file__).with_suffix(".toml").read_text("utf-8"))
PIEZOELECTRIC = (
    *("material", "s11", "s12", "s13", "s33", "s44", "s66", "d31", "d33", "d15"),
    *("eps11", "eps33", "Q factor", "loss tangent", "others"),
)
ELASTIC = (
    *("material", "E_x [GPa]", "E_z [GPa]", "nu_xy", "nu_xz", "G_yz [GPa]", "G_xy [GPa]"),
    *("eps11", "eps33"),
)


def digits(value: float | None) -> str:
    """The value with four digits; a dash if it is unknown."""
    return "-" if value is None else f"{value:.4g}"


def component(tensor: np.ndarray, name: str, unit: float) -> str:
    """The component ``s13`` or ``d31`` of a tensor, in multiples of a unit."""
    return digits(tensor[int(name[1]) - 1, int(name[2]) - 1] / unit)


def piezoelectric_row(material: materials.Material) -> list[str]:
    """Compliance, strain coefficients, and permittivity at constant stress."""
    s, d, eps = np.linalg.inv(material.C), material.d, material.eps_T / epsilon_0
    names = PIEZOELECTRIC[1:]
    cells = [component(s, name, 1e-12) for name in names if name.startswith("s")]
    cells += [component(d, name, 1e-12) for name in names if name.startswith("d")]
    cells += [digits(eps[0, 0]), digits(eps[2, 2])]
    cells += [digits(material.quality), digits(material.loss_tangent)]
    others = []
    for name, tensor in (("s14", s), ("d11", d), ("d14", d)):
        value = component(tensor, name, 1e-12)
        if abs(float(value)) > 1e-6:  # a smaller component is a rounding error
            others.append(f"{name} = {value}")
    return [f"`{material.name}`", *cells, ", ".join(others)]


def elastic_row(material: materials.Material) -> list[str]:
    """Young's moduli, Poisson's ratios, shear moduli and permittivity."""
    s, eps = np.linalg.inv(material.C), material.eps_S / epsilon_0
    insulates = not np.allclose(eps, np.eye(3))
    return [
        f"`{material.name}`",
        *(digits(1e-9 / s[k, k]) for k in (0, 2)),
        *(digits(-s[0, k] / s[0, 0]) for k in (1, 2)),
        *(digits(1e-9 / s[k, k]) for k in (3, 5)),
        *(digits(eps[k, k] if insulates else None) for k in (0, 2)),
    ]


if __name__ == "__main__":
    found = [materials.find_material(name) for name in NAMES]
    print_table(PIEZOELECTRIC, [piezoelectric_row(m) for m in found if m.is_piezoelectric])
    print()
    print_table(ELASTIC, [elastic_row(m) for m in found if not m.is_piezoelectric])
