"""Part types whose keys are the values of a data sheet."""
