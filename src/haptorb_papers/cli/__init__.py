"""Commands that compare, measure and reproduce: `bench`, `estimators`, `guidance` and `reproduce`."""
