"""What holds over people: one number per person, errors on the sphere, the plan and what came of it."""
