"""Linear models of bodies with named ports, from dimensions, meshes or files."""
