"""Decks, libraries, dialects, symbols."""

from kc2spice.spice.read import read_lib as read_lib
