"""The two modes of Bai 2012: a rotor with three degrees of freedom moves a target with six."""
