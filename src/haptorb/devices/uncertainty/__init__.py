"""How well the values of a device are known: the section [uncertainty] of a device file."""
