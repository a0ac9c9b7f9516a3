"""From field readings straight to torque per ampere: linear maps and small networks."""
