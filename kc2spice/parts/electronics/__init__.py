"""Part types of sources, two-pin elements, diodes, drivers and user's netlists."""
