"""Magnetostatics: fields, forces and torques of coils, magnets, dipoles and soft-magnetic spheres."""
