"""The error budget of the delivered wrench: what is not known exactly, and what it does to the wrench."""
