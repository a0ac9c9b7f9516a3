"""Registration of a tracker's frame and of the tool in its rigid body, from touches."""
