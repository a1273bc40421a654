"""Part types of bodies with reduced linear models, from meshes or matrix files."""
