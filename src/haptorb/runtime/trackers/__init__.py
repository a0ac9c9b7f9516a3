"""Sources of the tool pose: feeds over the network, filtered and checked."""
