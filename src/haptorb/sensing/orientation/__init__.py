"""A rotor's orientation from field readings, by least squares over the field tables."""
