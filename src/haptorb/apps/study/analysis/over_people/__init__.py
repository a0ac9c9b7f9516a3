"""What holds over people: one number per person, errors on the sphere."""
