"""Sources of magnetic field: magnets, coils, dipoles and soft-magnetic spheres."""
