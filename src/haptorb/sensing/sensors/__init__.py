"""The field sensors themselves: their errors, what these do to the tool's place, and a calibration that finds them."""
