"""Keys that linear bodies have in common, and type variables of parts that have such keys."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypeVar

from kc2spice.core.quantities import Section, Time, Voltage
from kc2spice.scene.settings import PartNumber, Rom

MAX_INSTANTS = 20  # largest number of instants that a run writes


class LinearKeys(Section):
    """Keys of every linear body."""

    rom: Rom | None = None
    number: PartNumber | None = Field(
        None,
        description="Part number, which is the name of the exported library; by default SCENE_PART",
    )
    rated_voltage: Voltage | None = Field(
        None,
        gt=0,
        description="Largest voltage between electrodes; by default computed from the limits of "
        "the materials",
    )


class FieldKeys(LinearKeys):
    """Keys of the stress and electric field inside the body.

    The key ``fields`` states whether a run computes both fields, or the instants of VTU files.
    """

    fields: (
        bool | Annotated[tuple[Time, ...], Field(min_length=1, max_length=MAX_INSTANTS)] | None
    ) = Field(
        None,
        description=(
            "Whether fields are computed, or a list of times for which VTU files are written"
        ),
    )


LinearKeysT = TypeVar("LinearKeysT", bound=LinearKeys, default=LinearKeys, covariant=True)
FieldKeysT = TypeVar("FieldKeysT", bound=FieldKeys, default=FieldKeys, covariant=True)
