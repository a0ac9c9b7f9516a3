"""Commands that compare and reproduce: `estimators`, `guidance` and `reproduce`."""
