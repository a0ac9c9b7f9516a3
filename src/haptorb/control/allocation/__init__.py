"""From a wanted wrench to currents: least squares for force, least heat for torque."""
