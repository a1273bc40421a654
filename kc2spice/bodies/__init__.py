"""Linear models of devices (bodies) with named ports, made from dimensions, meshes or files."""
