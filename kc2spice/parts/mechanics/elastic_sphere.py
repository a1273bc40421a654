"""The part ``elastic_sphere``: indentation and vibration of a sphere.

The part ``sphere`` models the rigid-body motion, to which indentation and vibration are added.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from pydantic import Field

from kc2spice.core.cache import load_or_build
from kc2spice.core.domains import TRANSLATION
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.progress import StageTimer
from kc2spice.fem.body_keys import BodyMeshKeys, DampingKeys
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.bodies._linear_body_keys import LinearKeys
from kc2spice.parts.mechanics._contact_keys import ContactKeys
from kc2spice.parts.mechanics._contact_surfaces import SPHERE_PATCH, ContactSurface, make_pair
from kc2spice.parts.mechanics.sphere import SphereKeys, make_sphere_material
from kc2spice.rom.linear_model import LinearModel, Port
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    DeclaredScene,
    GovernedScene,
    Part,
    Scene,
)
from kc2spice.scene.settings import RomKeys
from kc2spice.synthesis.mode_cards import COARSE_WEIGHTS, StepWeights

if TYPE_CHECKING:
    from kc2spice.bodies.contact_pressure import (
        LocalCompliance,
        PressureBasis,
        TransverselyIsotropicSphere,
    )

# Upper end of the frequency band, divided by the lowest natural frequency.
# A band up to twice the lowest natural frequency contains the sphere's radial mode.
BAND_RATIO = 2.0


class ElasticSphereKeys(LinearKeys):
    """Keys of the elasticity of a sphere.

    The key ``elastic`` of a sphere is a table that contains the keys ``damping``, ``mesh`` and
    ``rom``.
    """

    of: str = Field(
        examples=['"SPHERE"'], description="Name of the sphere whose elasticity this part models"
    )
    damping: DampingKeys = DampingKeys(ratio=1e-3)
    mesh: BodyMeshKeys = BodyMeshKeys()


class ElasticSphere(LinearBody[ElasticSphereKeys]):
    """Part type ``elastic_sphere``: deformation of a sphere about its centre of mass."""

    name = "elastic_sphere"
    title = "elasticity of a sphere, relative to its centre of mass (axisymmetric FE, reduced)"
    schema = ElasticSphereKeys
    source = "FE (elastic, axisymmetric, free)"
    discretisations = ("mesh.refine",)
    example = """
[impact]

[kick]
electrical = "open"

[contact]
shape = "pressure"

[sphere]
elastic = true
"""

    def dimensions(self, part: Part[ElasticSphereKeys]) -> int:
        """Return the number of spatial dimensions of the mesh."""
        return 2

    def ports(self, part: Part[ElasticSphereKeys], scene: DeclaredScene) -> tuple[Port, ...]:
        """Return the ports of the part's model."""
        return (Port(SPHERE_PATCH, TRANSLATION.port),)

    def problems(self, part: Part[ElasticSphereKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        _find_contact(part, scene)  # raises an error if the sphere's contact is not valid
        owner = scene.parts[part.keys.of].with_schema(SphereKeys)
        stuff = make_sphere_material(owner)
        if stuff.is_piezoelectric:
            yield owner.wrong(
                "material",
                "an elastic sphere cannot be piezoelectric",
                got=stuff.name,
                expected="a material that is not piezoelectric",
                hint='write  material = "steel"',
            )
        if part.keys.damping.per_material:
            yield owner.wrong(
                "elastic.damping.per_material",
                "damping per material does not apply to an elastic sphere",
                got=True,
                expected="ratio, quality or loss_factor",
                hint=DeleteKey("per_material"),
            )
        if part.keys.damping.model != "rayleigh":
            yield owner.wrong(
                "elastic.damping.model",
                "an elastic sphere has viscous damping only",
                got=part.keys.damping.model,
                expected='"rayleigh", the loss model of viscous damping',
                hint='delete the key `elastic.damping.model`, whose default is "rayleigh"',
            )

    def contact_surface(
        self, part: Part[ElasticSphereKeys], scene: GovernedScene, ports: tuple[str, ...] = ()
    ) -> ContactSurface | None:
        """Return the elastic patch as contact surface if it is the only port in ``ports``.

        Otherwise, return None. All other contact surfaces belong to the part ``sphere``.
        """
        if ports != (SPHERE_PATCH,):
            return None

        compliance, pace = (
            partial(self._find_compliance, part, scene),
            _make_elastic_sphere(part, scene).rayleigh_factors[1],
        )
        return ContactSurface(part.name, ports, (0.0,), compliance=compliance, pace=pace)

    def make_full_model_key(
        self, part: Part[ElasticSphereKeys], scene: GovernedScene
    ) -> Mapping[str, Any]:
        """Return the cache key of the full-order model: sphere, mesh and pressure nodes."""
        body, mesh = (
            _make_elastic_sphere(part, scene),
            part.keys.model_dump(mode="json", include={"mesh"}),
        )
        return {
            "radius": body.radius,
            "density": body.material.density,
            "stiffness": body.material.C.tolist(),
            "rayleigh": body.rayleigh_factors,
            "own": mesh,
            "pressure_basis": make_pair(
                _find_contact(part, scene), scene
            ).pressure_basis.nodes.tolist(),
        }

    def make_full_model(
        self, part: Part[ElasticSphereKeys], scene: GovernedScene, clock: StageTimer
    ) -> LinearModel:
        """Build the full-order finite-element model of the elastic sphere."""
        from kc2spice.bodies.contact_pressure import make_sphere_model

        shape = make_pair(_find_contact(part, scene), scene).pressure_basis
        with clock.time_stage("assemble", f"mesh and matrices of {part.name}"):
            shares = self._find_compliance(part, scene, shape).rigid_force_shares
            return make_sphere_model(
                _make_elastic_sphere(part, scene), shares, shape, part.keys.mesh.refine
            )

    def choose_reduction(self, part: Part[ElasticSphereKeys], scene: Scene) -> RomKeys:
        """Return the reduction settings of the elastic sphere.

        The settings of the scene do not apply, because the modes of a sphere are above the
        frequency band of any actuator.
        """
        specified: RomKeys | None = part.keys.rom
        if specified is not None:
            return specified
        return RomKeys(
            tolerance=1e-3,
            band=(
                0.0,
                float(f"{BAND_RATIO * _make_elastic_sphere(part, scene).oblate_frequency:.3g}"),
            ),
        )

    def weights(self, part: Part[ElasticSphereKeys], scene: DeclaredScene) -> StepWeights:
        """Return the weights of the body's modes in the simulator's time step control.

        The weights ``COARSE_WEIGHTS`` permit long time steps, which do not resolve the sphere's
        ringing in free flight. Resolution of the sphere's ringing in free flight would require
        eight times as many time steps at a damping ratio of 0.01 %.
        """
        return COARSE_WEIGHTS

    def list_neglected_effects(
        self, part: Part[ElasticSphereKeys], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield the neglected effect: the ringing of the sphere in free flight."""
        why = "in free flight, time steps do not resolve the vibration of the sphere; the "
        why += "vibration does not change the path of the centre of mass"
        yield NeglectedEffect(f"free ringing of {part.keys.of}", why, "no effect on the path")

    def notes(self, part: Part[ElasticSphereKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        yield from super().notes(part, scene)
        deep = (
            make_pair(_find_contact(part, scene), scene).contact_force.depth
            / _make_elastic_sphere(part, scene).radius
        )
        yield NeglectedEffect(
            f"slope of the surface of {part.keys.of} in the contact area",
            "the contact pressure acts parallel to the axis",
            f"at most {100 * deep:.1g} % of the indentation (indentation / sphere radius)",
            size=deep,
        )

    def _find_compliance(
        self, part: Part[ElasticSphereKeys], scene: GovernedScene, shape: PressureBasis
    ) -> LocalCompliance:
        """Return the local compliance of the sphere in a pressure basis."""
        from kc2spice.bodies.contact_pressure import LocalCompliance, compute_sphere_compliance

        key = {**self.make_full_model_key(part, scene), "pressure_basis": shape.nodes.tolist()}
        arguments, kinds = (
            (_make_elastic_sphere(part, scene), shape, part.keys.mesh.refine),
            (LocalCompliance,),
        )
        return load_or_build(
            "indented",
            key,
            lambda: compute_sphere_compliance(*arguments),
            classes=kinds,
            sources=self.source_modules(),
        )


def _make_elastic_sphere(
    part: Part[ElasticSphereKeys], scene: DeclaredScene
) -> TransverselyIsotropicSphere:
    """Return the sphere's radius, material and losses for the finite-element model."""
    from kc2spice.bodies.contact_pressure import TransverselyIsotropicSphere

    owner = scene.parts[part.keys.of].with_schema(SphereKeys)
    return TransverselyIsotropicSphere(
        owner.keys.radius, make_sphere_material(owner), part.keys.damping
    )


def _find_contact(part: Part[ElasticSphereKeys], scene: GovernedScene) -> Part[ContactKeys]:
    """Return the only contact of the sphere.

    Raise an error if the sphere has several contacts, or if the contact has no pressure basis.
    """
    owner = scene.parts[part.keys.of]
    pairs = (
        (contact, make_pair(contact, scene))
        for contact in scene.list_parts_with_schema("contact", ContactKeys)
    )
    result = [
        contact
        for contact, p in pairs
        if part.name in (p.lower_surface.elastic, p.upper_surface.elastic)
    ]
    if len(result) != 1:
        got = ", ".join(c.name for c in result) or "none"
        raise owner.wrong(
            "elastic",
            "an elastic sphere needs exactly one contact",
            got=got,
            expected=(
                'one contact with shape = "pressure", and with the name of a body in its key `a`'
            ),
            hint=DeleteKey("elastic") if not result else f"delete the contact {result[-1].name}",
        )
    (contact,) = result
    if contact.keys.shape != "pressure":
        raise contact.wrong(
            "shape",
            (
                f"the indentation of an elastic sphere by {contact.name} does not converge with "
                'shape = "rings"'
            ),
            got=f'shape = "{contact.keys.shape}"',
            expected='shape = "pressure"',
            hint=f'set {contact.name}.shape = "pressure", or {owner.name}.elastic = false',
        )
    if damping := contact.keys.damping:
        raise contact.wrong(
            "damping",
            "damping of the contact does not apply to an elastic sphere",
            got=damping,
            expected=f"0, with the damping of the sphere in {owner.name}.elastic.damping",
            hint=f"delete {contact.name}.damping",
        )
    return contact


register_part_type(ElasticSphere())
