"""Independent scipy oracle of the loop, the impact, the imprint and the harmonic response."""

from kc2spice.reference.loop import EnergyBook, Event, Reference, impact, kick_and_catch
from kc2spice.reference.statics import harmonic, imprint, spectra, transfer

__all__ = [
    "EnergyBook",
    "Event",
    "Reference",
    "harmonic",
    "impact",
    "imprint",
    "kick_and_catch",
    "spectra",
    "transfer",
]
