"""Part types whose keys are the values of a maker's data sheet."""
