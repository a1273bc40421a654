"""Sources, elements with two pins, diodes, drivers and the user's own netlists."""
