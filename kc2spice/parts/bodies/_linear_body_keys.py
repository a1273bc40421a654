"""Keys common to all linear bodies, and the type variables of these keys."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypeVar

from kc2spice.core.quantities import Section, Time, Voltage
from kc2spice.scene.settings import PartNumber, RomKeys

MAX_INSTANTS = 20  # largest number of instants at which a run writes the fields to a file


class LinearKeys(Section):
    """Base class for the keys of all linear bodies."""

    rom: RomKeys | None = None
    number: PartNumber | None = Field(
        None,
        description=(
            "Part number (text), also the name of the exported library; by default the names of "
            "scene and part, joined by an underscore"
        ),
    )
    rated_voltage: Voltage | None = Field(
        None,
        gt=0,
        description=(
            "Largest permitted voltage between the electrodes; by default computed from the "
            "limits of the materials"
        ),
    )


class FieldKeys(LinearKeys):
    """Keys for the fields inside a body: stress and electric field, or temperature.

    The key ``fields`` states whether a run computes the inner fields, or lists the times at which
    the run also writes them to VTU files.
    """

    fields: (
        bool | Annotated[tuple[Time, ...], Field(min_length=1, max_length=MAX_INSTANTS)] | None
    ) = Field(
        None,
        description=(
            "Whether a run computes the fields inside the body, or a list of times at which "
            "the run writes these fields to VTU files"
        ),
    )


LinearKeysT = TypeVar("LinearKeysT", bound=LinearKeys, default=LinearKeys, covariant=True)
FieldKeysT = TypeVar("FieldKeysT", bound=FieldKeys, default=FieldKeys, covariant=True)
