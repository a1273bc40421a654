"""Full model, laws of the reduced models and ngspice on the emitted file, against each other."""
