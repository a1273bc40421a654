"""Bodies: parametric devices as LinearModels with named, typed ports."""
