"""Arrays in, arrays out: magnetostatics, beams, heat. No memory, no clock, no device."""
