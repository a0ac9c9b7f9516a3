"""Ball-joint spherical motors with permanent magnets: the PMSM of Bai 2012 and its relatives."""
