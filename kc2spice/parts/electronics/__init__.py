"""Part types of sources, elements with two pins, diodes, drivers and user's netlists."""
